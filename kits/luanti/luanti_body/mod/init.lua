-- One player without a screen: its actions, by the rules of the game, and what it sees, as lines of JSON over TCP.
--
-- A request is {id, call, args}; its answer {id, result} or {id, error}. Positions are {x, y, z} of nodes; the player
-- stands in the node of its feet and fills the one above. Nothing happens between requests but what the game does.

local NAME, RANGE, REACH, EYE = "agent", 16, 4.5, 1.12 -- nodes; the eye above the centre of the feet's node
local FALL_FREE, GRAVITY, FALL_SPEED = 3, 9.81, 14 -- a fall hurts by the speed above 14 nodes/s, as in the client
local SEARCHED = 8 -- nodes a second that come into view where one digs, about
local DAY_S = 86400 / 72 -- of one day at the game's own `time_speed`
local FACES = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}}
local calls = {}
local at = nil -- node of the feet
local known, known_names, sent_times = {}, {}, ""

local function vec(t) return {x = t[1], y = t[2], z = t[3]} end
local function arr(v) return {v.x, v.y, v.z} end
local function up(p, n) return {x = p.x, y = p.y + n, z = p.z} end
local function agent() return minetest.get_player_by_name(NAME) end
local function refuse(text, ...) error({refused = string.format(text, ...)}) end

local function node_at(p)
	if not minetest.get_node_or_nil(p) then minetest.load_area(p) end
	local node = minetest.get_node(p)
	return node, minetest.registered_nodes[node.name] or {walkable = true}
end
local function is_open(p) local _, def = node_at(p) return not def.walkable end
local function holds_up(p) -- whether who is in `p` does not fall
	local _, def = node_at(p)
	return def.climbable or (def.liquidtype or "none") ~= "none" or not is_open(up(p, -1))
end

local function stand(p)
	local fall = 0
	while is_open(p) and not holds_up(p) and fall < 200 do p, fall = up(p, -1), fall + 1 end
	local player = agent()
	at = p
	player:set_pos(up(p, -0.5))
	local hurt = math.floor(math.sqrt(2 * GRAVITY * fall) - FALL_SPEED)
	if hurt >= 1 then player:set_hp(player:get_hp() - hurt, {type = "fall"}) end
end
local function eye() return up(at, EYE) end

-- What is seen
local SIDE = 2 * RANGE + 1
local rays -- ray after ray, indices from 1 into the cube of SIDE^3 around the node of the eye
local cube = {} -- of each index its offset from that node
local function make_rays()
	rays = {}
	for x = -RANGE, RANGE do for y = -RANGE, RANGE do for z = -RANGE, RANGE do
		cube[#cube + 1] = {x = x, y = y, z = z}
		if math.max(math.abs(x), math.abs(y), math.abs(z)) == RANGE then
			local ray, last, rise = {}, nil, y - EYE + 1
			local length = math.sqrt(x * x + rise * rise + z * z)
			for step = 0, RANGE, 0.25 do
				local part = step / length
				local i, j, k = math.floor(x * part + 0.5), math.floor(EYE - 1 + rise * part + 0.5), math.floor(z * part + 0.5)
				local index = ((i + RANGE) * SIDE + j + RANGE) * SIDE + k + RANGE + 1
				if index ~= last then ray[#ray + 1], last = index, index end
			end
			rays[#rays + 1] = ray
		end
	end end end
end
local passes = {} -- by content id: whether light passes
local function lets_through(id)
	if passes[id] == nil then
		local def = minetest.registered_nodes[minetest.get_name_from_content_id(id)]
		passes[id] = def ~= nil and (def.sunlight_propagates or not def.walkable) and id ~= minetest.CONTENT_IGNORE or false
	end
	return passes[id]
end

local function note(new, p, name)
	if not known_names[name] then
		known_names[name], known_names[known_names.n], known_names.n = known_names.n, name, known_names.n + 1
	end
	for _, each in ipairs({p.x, p.y, p.z, known_names[name]}) do new[#new + 1] = each end
end
local buffer = {}
local function look() -- new or changed nodes in view, as x, y, z, index of its name from 0
	if not rays then make_rays() end
	local centre = up(at, 1)
	local low, high = vector.subtract(centre, RANGE), vector.add(centre, RANGE)
	local manip = minetest.get_voxel_manip()
	local min, max = manip:read_from_map(low, high)
	local area = VoxelArea:new({MinEdge = min, MaxEdge = max})
	local data = manip:get_data(buffer)
	local base, y_stride, z_stride = area:indexp(centre), area.ystride, area.zstride
	local seen, new = {}, {}
	for index = 1, #cube do seen[index] = false end
	for _, ray in ipairs(rays) do
		for step = 1, #ray do
			local index = ray[step]
			local id = seen[index]
			if not id then
				local d = cube[index]
				id = data[base + d.x + d.y * y_stride + d.z * z_stride]
				seen[index] = id
				local p = vector.add(centre, d)
				local key = minetest.hash_node_position(p)
				if known[key] ~= id and id ~= minetest.CONTENT_IGNORE then
					known[key] = id
					note(new, p, minetest.get_name_from_content_id(id))
				end
			end
			if not lets_through(id) then break end
		end
	end
	return new
end

local function is_clear(from, to, node) -- whether no other node is between two points
	local ray = vector.direction(from, to)
	for step = 0, vector.distance(from, to), 0.1 do
		local c = vector.round(vector.add(from, vector.multiply(ray, step)))
		if vector.equals(c, node) then return true end
		if not lets_through(minetest.get_content_id(node_at(c).name)) then return false end
	end
	return true
end

local function sees(p) -- its centre, or the middle of a face
	if is_clear(eye(), p, p) then return true end
	for _, d in ipairs(FACES) do
		if is_clear(eye(), vector.add(p, vector.multiply(vec(d), 0.49)), p) then return true end
	end
	return false
end
local function reach(p)
	if vector.distance(eye(), p) > REACH or not sees(p) then refuse("%s is out of reach", minetest.pos_to_string(p)) end
end

local function list_creatures(radius)
	local found = {}
	for _, object in ipairs(minetest.get_objects_inside_radius(eye(), radius)) do
		local entity, p = object:get_luaentity(), vector.round(object:get_pos())
		if entity and entity.name:sub(1, 2) ~= "__" and sees(p) then
			found[#found + 1] = {object = object, name = entity.name, at = p}
		end
	end
	return found
end

-- What is carried
local function main() return agent():get_inventory() end

local breadths = {} -- of tools: how many kinds of nodes they dig
local function measure_breadth(tool)
	if not breadths[tool] then
		local count, capabilities = 0, minetest.registered_items[tool].tool_capabilities
		for _, def in pairs(minetest.registered_nodes) do
			if minetest.get_dig_params(def.groups or {}, capabilities).diggable then count = count + 1 end
		end
		breadths[tool] = count
	end
	return breadths[tool]
end

local function find_tool(groups) -- time of digging, and the slot of the tool, 0 for the hand: the one that digs least
	local params = minetest.get_dig_params(groups, minetest.registered_items[""].tool_capabilities)
	if params.diggable then return params.time, 0 end -- it does not wear
	local best, slot, least = nil, 0, math.huge
	for i, stack in ipairs(main():get_list("main")) do
		params = minetest.registered_tools[stack:get_name()] and
			minetest.get_dig_params(groups, stack:get_tool_capabilities()) or {}
		if params.diggable and measure_breadth(stack:get_name()) < least then
			best, slot, least = params.time, i, measure_breadth(stack:get_name())
		end
	end
	return best, slot
end

local function wield(slot) -- bring a slot into the hand; 0 empties it
	local inventory = main()
	local held = inventory:get_stack("main", 1)
	if slot == 0 and held:is_empty() or slot == 1 then return end
	for i, stack in ipairs(inventory:get_list("main")) do if slot == 0 and stack:is_empty() then slot = i end end
	if slot == 0 then return end
	inventory:set_stack("main", 1, inventory:get_stack("main", slot))
	inventory:set_stack("main", slot, held)
end

local function list_times() -- seconds to dig each kind of node that was seen, by what is carried
	local times = {}
	for i = 0, known_names.n - 1 do
		local def = minetest.registered_nodes[known_names[i]]
		if def and def.diggable ~= false and def.groups then times[known_names[i]] = find_tool(def.groups) end
	end
	return times
end
local function find_slot(item)
	for i, stack in ipairs(main():get_list("main")) do if stack:get_name() == item then return i end end
	refuse("carries no %s", item)
end

local function fits(name, wanted) -- whether an item is one of a recipe, which may be `group:a,b`
	if wanted:sub(1, 6) ~= "group:" then return name == wanted end
	for _, g in ipairs(wanted:sub(7):split(",")) do if minetest.get_item_group(name, g) == 0 then return false end end
	return true
end

local function fill(recipe, counts) -- a grid of items that are carried, or nil and what lacks
	local left, grid, names = {}, {}, {}
	for name, count in pairs(counts) do left[name], names[#names + 1] = count, name end
	table.sort(names, function(a, b) return counts[a] > counts[b] or counts[a] == counts[b] and a < b end)
	for _, is_group in ipairs({false, true}) do
		for i = 1, 9 do
			local wanted = recipe.items[i]
			if wanted and wanted ~= "" and (wanted:sub(1, 6) == "group:") == is_group then
				for _, name in ipairs(names) do
					if left[name] > 0 and fits(name, wanted) then grid[i] = name break end
				end
				if not grid[i] then return nil, wanted end
				left[grid[i]] = left[grid[i]] - 1
			end
		end
	end
	for i = 1, 9 do grid[i] = ItemStack(grid[i] or "") end
	return grid
end
local function count_items()
	local counts = {}
	for _, stack in ipairs(main():get_list("main")) do
		if not stack:is_empty() then counts[stack:get_name()] = (counts[stack:get_name()] or 0) + stack:get_count() end
	end
	return counts
end
local function add(stack)
	local rest = main():add_item("main", stack)
	if not rest:is_empty() then minetest.add_item(at, rest) end
end

-- Silver of moreores has no other setting than a depth: here the same ore is in lifted land, too.
local height = tonumber(minetest.settings:get("water_level"))
for _, ore in pairs(table.copy(minetest.registered_ores)) do
	if ore.ore == "moreores:mineral_silver" then
		ore.y_min, ore.y_max = 1, 31000
		minetest.register_ore(ore)
	end
end

-- Calls of an agent
function calls.look()
	local player = agent()
	local names, first = {}, known_names.sent
	local new = look()
	for i = first, known_names.n - 1 do names[#names + 1] = known_names[i] end
	known_names.sent = known_names.n
	local times = list_times()
	local text = minetest.write_json(times)
	times, sent_times = text ~= sent_times and times or nil, text
	local seen = {}
	for i, each in ipairs(list_creatures(RANGE)) do seen[i] = {each.name, arr(each.at)} end
	return {
		at = arr(at), hp = player:get_hp(), breath = player:get_breath(), day = minetest.get_timeofday(),
		light = minetest.get_node_light(up(at, 1)) or 0, items = count_items(), names = names, nodes = new,
		times = times, creatures = seen,
	}
end

function calls.pass(args) -- so much time goes by on the clock of the day
	return minetest.set_timeofday((minetest.get_timeofday() + args.seconds / DAY_S) % 1) or {}
end

function calls.go(args)
	local to = vec(args.to)
	local rise = to.y - at.y
	if math.abs(to.x - at.x) + math.abs(to.z - at.z) > 1 or rise > 1 or rise < -FALL_FREE then refuse("is no step") end
	if rise == 1 and not is_open(up(at, 2)) then refuse("there is no room to jump") end
	for y = math.min(to.y, at.y + (rise > 0 and 1 or 0)), math.max(to.y, at.y) + 1 do
		if not is_open({x = to.x, y = y, z = to.z}) then refuse("a node is before it") end
	end
	stand(to)
	return {}
end

function calls.dig(args)
	local p = vec(args.at)
	reach(p)
	local node, def = node_at(p)
	local time, slot = find_tool(def.groups or {})
	if not time or def.diggable == false then refuse("%s needs another tool", node.name) end
	wield(slot)
	def.on_dig(p, node, agent())
	if node_at(p).name == node.name then refuse("%s stays", node.name) end
	for _, object in ipairs(minetest.get_objects_inside_radius(p, 3)) do
		local entity = object:get_luaentity()
		if entity and entity.name == "__builtin:item" then
			add(ItemStack(entity.itemstring))
			object:remove()
		end
	end
	stand(at)
	return {}
end

function calls.put(args) -- place a node; under its feet where it stands itself
	local p, slot = vec(args.at), find_slot(args.item)
	local _, def = node_at(p)
	if not def.buildable_to then refuse("there is no room for %s", args.item) end
	local is_below = vector.equals(p, at)
	if is_below and not is_open(up(at, 2)) then refuse("there is no room to jump") end
	if vector.equals(p, up(at, 1)) then refuse("it is there itself") end
	if not is_below then reach(p) end
	for _, d in ipairs(FACES) do
		local under = vector.add(p, vec(d))
		if not is_open(under) then
			if is_below then stand(up(at, 1)) end
			local stack = main():get_stack("main", slot)
			local item = minetest.registered_items[args.item]
			local rest = (item.on_place or minetest.item_place)(stack, agent(), {type = "node", under = under, above = p})
			if rest then main():set_stack("main", slot, rest) end
			stand(at)
			if node_at(p).name == "air" then refuse("%s does not stay there", args.item) end
			return {}
		end
	end
	refuse("nothing to put %s against", args.item)
end

function calls.craft(args)
	local lacks = "a recipe"
	for _, recipe in ipairs(minetest.get_all_craft_recipes(args.item) or {}) do
		local grid, lacking = nil, nil
		if recipe.method == "normal" then grid, lacking = fill(recipe, count_items()) end
		if grid then
			local out, rest = minetest.get_craft_result({
				method = "normal", width = recipe.width > 0 and recipe.width or 3, items = grid,
			})
			if not main():room_for_item("main", out.item) then refuse("there is no room to carry %s", args.item) end
			for _, stack in ipairs(grid) do if not stack:is_empty() then main():remove_item("main", stack:get_name()) end end
			for _, stack in ipairs(rest.items) do if not stack:is_empty() then add(stack) end end
			for _, stack in ipairs(out.replacements or {}) do add(stack) end
			add(out.item)
			return {made = out.item:get_count()}
		end
		lacks = lacking or lacks
	end
	refuse("%s lacks %s", args.item, lacks)
end

function calls.furnace(args) -- put `source` and `fuel` in, let it work for `seconds`, or take all out
	local p = vec(args.at)
	reach(p)
	local def = minetest.registered_nodes[node_at(p).name]
	local furnace = minetest.get_meta(p):get_inventory()
	if not furnace:get_list("src") then refuse("is no furnace") end
	for list, given in pairs({src = args.source, fuel = args.fuel}) do
		local rest = furnace:add_item(list, main():remove_item("main", ItemStack(given)))
		if not rest:is_empty() then add(rest) end
	end
	if args.seconds then def.on_timer(p, args.seconds) end
	if args.take then
		for _, list in ipairs({"src", "fuel", "dst"}) do
			for i, stack in ipairs(furnace:get_list(list)) do
				if not stack:is_empty() then add(stack) end
				furnace:set_stack(list, i, "")
			end
		end
	end
	local done = furnace:get_stack("dst", 1)
	return {done = done:is_empty() and 0 or done:get_count()}
end

function calls.eat(args)
	local slot = find_slot(args.item)
	local stack, item = main():get_stack("main", slot), minetest.registered_items[args.item]
	if not item.on_use then refuse("%s is nothing to eat", args.item) end
	main():set_stack("main", slot, item.on_use(stack, agent(), {type = "nothing"}) or stack)
	return {}
end

function calls.equip(args) -- into the hand; armour is put on where the game has it
	local slot = find_slot(args.item)
	local armour = rawget(_G, "armor")
	if not (armour and armour:get_element(args.item)) then return wield(slot) or {} end
	main():set_stack("main", slot, armour:equip(agent(), main():get_stack("main", slot)))
	return {}
end

function calls.attack()
	local near = list_creatures(REACH)[1]
	if not near then refuse("nothing is in reach") end
	near.object:punch(agent(), 1.0, agent():get_wielded_item():get_tool_capabilities(), nil)
	return {struck = near.name}
end

-- Calls that keep the world; no tool of an agent has them
local function find_forest(x, z) -- the height of the ground where it is one
	local level = minetest.get_spawn_level(x, z)
	local biome = level and minetest.get_biome_data({x = x, y = level, z = z})
	return biome and minetest.get_biome_name(biome.biome):find("forest$") and level
end

function calls.make(args, reply) -- generate the land around the nearest forest; answers with the start
	for ring = 0, 40 do
		for _, d in ipairs({{1, 0}, {0, 1}, {-1, 0}, {0, -1}, {1, 1}, {-1, -1}, {1, -1}, {-1, 1}}) do
			local start = {x = d[1] * ring * 80, z = d[2] * ring * 80}
			start.y = find_forest(start.x, start.z)
			if start.y then
				minetest.emerge_area(vector.subtract(start, args.around), vector.add(start, args.around), function(_, _, left)
					if left > 0 then return end
					while not (is_open(start) and is_open(up(start, 1))) do start = up(start, 1) end
					while is_open(up(start, -1)) do start = up(start, -1) end
					reply({start = arr(start)})
				end)
				return nil
			end
		end
	end
	refuse("no forest within 3200 nodes")
end

function calls.begin(args) -- stand at the start with empty hands, in the morning
	local player = agent()
	if not player then return {is_there = false} end
	local inventory = player:get_inventory()
	for list in pairs(inventory:get_lists()) do inventory:set_list(list, {}) end
	known, known_names, sent_times = {}, {n = 0, sent = 0}, ""
	minetest.set_timeofday(args.day)
	player:set_hp(player:get_properties().hp_max)
	stand(vec(args.start))
	return {is_there = true}
end

local function list_recipes(item)
	local found = {}
	for _, each in ipairs(minetest.get_all_craft_recipes(item) or {}) do
		local recipe = {method = each.method, items = {}, output = each.output, time = 0}
		for i = 1, 9 do if (each.items[i] or "") ~= "" then table.insert(recipe.items, each.items[i]) end end
		if each.method == "cooking" then
			local cooked = {method = "cooking", width = 1, items = {ItemStack(recipe.items[1])}}
			recipe.time = minetest.get_craft_result(cooked).time
		end
		if #recipe.items > 0 then found[#found + 1] = recipe end
	end
	return found
end

function calls.book() -- the game's own book: recipes, what nodes drop, and how they are dug
	local book = {recipes = {}, nodes = {}, groups = {}, ground = {}}
	for name, def in pairs(minetest.registered_items) do
		local recipes = list_recipes(name)
		if #recipes > 0 then book.recipes[name] = recipes end
		for group in pairs(def.groups or {}) do
			book.groups[group] = book.groups[group] or {}
			table.insert(book.groups[group], name)
		end
	end
	for _, ore in pairs(minetest.registered_ores) do
		if (ore.y_max or 31000) >= height and (ore.y_min or -31000) <= height then -- seconds until one is found, about
			local seconds = ore.ore_type == "scatter" and ore.clust_scarcity / ore.clust_num_ores / SEARCHED or 100
			book.ground[ore.ore] = math.min(book.ground[ore.ore] or seconds, seconds)
		end
	end
	for _, biome in pairs(minetest.registered_biomes) do
		for _, key in ipairs({"node_top", "node_filler", "node_stone"}) do
			if biome[key] and (biome.y_min or -31000) >= 0 then book.ground[biome[key]] = 0 end
		end
	end
	book.ground["default:stone"] = 0
	for name, def in pairs(minetest.registered_nodes) do
		local drop, drops, tools = def.drop or name, {}, {}
		for _, each in ipairs(type(drop) == "string" and {{items = {drop}}} or drop.items or {}) do
			for _, item in ipairs(each.items) do drops[#drops + 1] = ItemStack(item):get_name() end
		end
		for tool, each in pairs(minetest.registered_items) do
			local params = each.tool_capabilities and minetest.get_dig_params(def.groups or {}, each.tool_capabilities)
			if params and params.diggable and def.diggable ~= false then tools[tool] = params.time end
		end
		book.nodes[name] = {
			drops = drops, is_solid = def.walkable and true or false, hurts = (def.damage_per_second or 0) > 0,
			is_liquid = (def.liquidtype or "none") ~= "none", falls = (def.groups or {}).falling_node ~= nil, tools = tools,
		}
	end
	return book
end
function calls.stop() minetest.request_shutdown("", false, 0) return {} end

-- The channel
local insecure = minetest.request_insecure_environment()
local port = tonumber(minetest.settings:get("phyagentos_port"))
local core = assert(insecure, "phyagentos is not in secure.trusted_mods").package.loadlib(
	minetest.settings:get("phyagentos_socket"), "luaopen_socket_core")()
local server = core.tcp4 and core.tcp4() or core.tcp()
server:setoption("reuseaddr", true)
assert(server:bind("127.0.0.1", port))
assert(server:listen(1))
server:settimeout(0)
local client

local function send(answer)
	client:settimeout(30)
	client:send(minetest.write_json(answer) .. "\n")
end

local function answer(line)
	local request = minetest.parse_json(line)
	local function reply(result) send({id = request.id, result = result}) end
	local is_done, result = pcall(calls[request.call], request.args or {}, reply)
	local refused = type(result) == "table" and result.refused or tostring(result)
	if not is_done then send({id = request.id, error = refused}) elseif result then reply(result) end
end

minetest.register_globalstep(function()
	client = client or server:accept()
	if not client then return end
	client:setoption("tcp-nodelay", true)
	local begun, wait = minetest.get_us_time(), 0
	repeat
		client:settimeout(wait)
		local line, err = client:receive("*l")
		if line then answer(line) elseif err == "closed" then client = nil end
		wait = 0.003
	until not line or minetest.get_us_time() - begun > 50000
end)
