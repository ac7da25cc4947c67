"""What was planted and never struck is told."""

import json

from phyagentos.assembly.planted_faults import find_unstruck

FILE = """
version: 1
faults:
  - {kind: slip, object: red_cube}
  - {kind: slip, object: blue_cube}
  - {kind: blackout, camera: "top*"}
  - {kind: stall, joint: joint4, object: red_cube}
"""


def plant(root, text, *strikes):
    (root / ".world").mkdir(exist_ok=True)
    (root / ".world" / "faults.yaml").write_text(text)
    bundle = root / "evidence" / "g.red"
    bundle.mkdir(parents=True, exist_ok=True)
    records = [{"kind": kind, "time_s": 1.0, "details": {"kind": kind, "body": body}} for kind, body in strikes]
    (bundle / "faults.json").write_text(json.dumps(records))
    return root


def test_a_fault_that_never_struck_is_named(tmp_path):
    plant(tmp_path, FILE, ("slip", "red_cube"), ("stall", "joint4"))
    assert find_unstruck(tmp_path) == ("slip of blue_cube", "blackout of top*")


def test_one_strike_is_not_counted_for_two_faults(tmp_path):
    twice = FILE.replace("blue_cube", "red_cube")
    plant(tmp_path, twice, ("slip", "red_cube"), ("blackout", "top*"), ("stall", "joint4"))
    assert find_unstruck(tmp_path) == ("slip of red_cube",)


def test_a_drawn_fault_is_struck_by_any_of_its_kinds(tmp_path):
    text = "version: 1\ndraw: {one_of: [slip, nudge], objects: [red_cube]}\n"
    assert find_unstruck(plant(tmp_path, text, ("nudge", "red_cube"))) == ()
    assert find_unstruck(plant(tmp_path, text)) == ("one of slip, nudge, of red_cube",)


def test_without_a_fault_file_nothing_is_missed(tmp_path):
    assert find_unstruck(tmp_path) == ()
