"""Luanti-67, our mapping: the tasks of Optimus-1's seven groups by what they have for counterpart in Luanti's game.

The names of the groups and what each is after are those of the benchmark of Optimus-1 (arXiv:2408.03615), without its
six tasks of gathering. Items that the game lacks are replaced: a stand-in is named as what it is.
"""

from collections.abc import Mapping
from types import MappingProxyType

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "Wood": (
        "default_shovel_wood", "default_pick_wood", "default_axe_wood", "farming_hoe_wood", "default_stick",
        "default_sword_wood", "default_chest", "default_sign_wall_wood", "default_ladder_wood", "group_wood",
    ),
    "Stone": (
        "default_shovel_stone", "default_pick_stone", "default_axe_stone", "farming_hoe_stone", "default_coal_lump",
        "default_sword_stone", "default_furnace", "default_torch", "default_stone",
    ),
    "Iron": (
        "default_shovel_steel", "default_pick_steel", "default_axe_steel", "farming_hoe_steel", "bucket_bucket_empty",
        "mesecons_hydroturbine_hydro_turbine_off", "carts_rail", "default_sword_steel", "screwdriver_screwdriver",
        "default_steelblock", "doors_door_steel", "default_ladder_steel", "xpanes_bar_flat", "default_steel_ingot",
        "doors_trapdoor_steel", "default_sign_wall_steel",
    ),
    "Gold": (
        "moreores_shovel_silver", "moreores_pick_silver", "moreores_axe_silver", "default_gold_lump",
        "moreores_sword_silver", "default_gold_ingot",
    ),
    "Diamond": (
        "default_shovel_diamond", "default_pick_diamond", "default_axe_diamond", "default_mese",
        "default_sword_diamond", "default_diamond", "default_diamondblock",
    ),
    "RedStone": (
        "mesecons_pistons_piston_normal_off", "mesecons_torch_mesecon_torch_on", "carts_powerrail",
        "mesecons_delayer_delayer_off_1", "mesecons_walllever_wall_lever_off", "mesecons_noteblock_noteblock",
    ),
    "Armor": (
        "shields_shield_wood", "_3d_armor_chestplate_steel", "_3d_armor_boots_steel", "_3d_armor_leggings_steel",
        "_3d_armor_helmet_steel", "_3d_armor_helmet_diamond", "_3d_armor_chestplate_diamond",
        "_3d_armor_leggings_diamond", "_3d_armor_boots_diamond", "_3d_armor_helmet_gold", "_3d_armor_leggings_gold",
        "_3d_armor_boots_gold", "_3d_armor_chestplate_gold",
    ),
})  # fmt: skip
