"""Packages as if they were installed: a module and what an installer writes beside it."""


def install(site, name, code, groups) -> None:
    """Lay a package below `site`, a folder on the path of Python; `groups` are its entry points by group and name."""
    information = site / f"{name}-1.0.dist-info"
    information.mkdir(parents=True)
    (site / f"{name}.py").write_text(code)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    points = ("\n".join((f"[{group}]", *map(" = ".join, each.items()))) for group, each in groups.items())
    (information / "entry_points.txt").write_text("\n".join((*points, "")))
