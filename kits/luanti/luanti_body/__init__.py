"""A player of Luanti (Minetest) as a target of phyagentos."""
