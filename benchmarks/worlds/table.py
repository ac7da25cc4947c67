"""The table on which perception is tried: one scene file for the benchmark and the tests."""

HEAD = """
scene: {name}
materials:
  wood: {{rgba: [0.86, 0.68, 0.48, 1]}}
  floor: {{rgba: [0.82, 0.84, 0.87, 1]}}
  red: {{rgba: [0.82, 0.16, 0.14, 1]}}
  blue: {{rgba: [0.12, 0.33, 0.78, 1]}}
  green: {{rgba: [0.15, 0.6, 0.27, 1]}}
areas:
  floor: {{x_m: [0.40, 0.60], y_m: [-0.30, 0.05]}}
bodies:
  table:
    kind: table
    fixed: true
    material: wood
    place: {{position_m: [0.38, 0.05, -0.02]}}
    shapes: [{{kind: box, size_m: [0.52, 0.65, 0.02]}}]
"""
TAIL = """
cameras: {}
lights:
  key: {position_m: [1.2, -1.2, 2.2], direction: [-0.4, 0.55, -1.0], diffuse: [0.65, 0.63, 0.6]}
"""
TOP = "cameras:\n  top: {position_m: [0.5, 0.05, 1.6], target_m: [0.501, 0.051, 0.0], fovy_deg: 45}"


def render_table(name: str, bodies: str) -> str:
    """The scene file of a wooden table with these bodies, which are indented by two blanks."""
    return HEAD.format(name=name) + bodies.strip("\n") + TAIL
