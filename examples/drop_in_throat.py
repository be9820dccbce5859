"""Drop in a throat: oil that a pressure drop pushes towards the throat between two grains, 2D.

    python examples/drop_in_throat.py
"""

import isphcli


def main(spacing: float = 8e-6, end: float = 2e-3, quiet: bool = False) -> isphcli.RunResult:
    """The case that `isph init --drop` writes, up to the time `end` (s)."""
    case = {
        "title": "Drop in a throat",
        "geometry": {
            "box": [4e-4, 2e-4],
            "periodic": ["x"],
            "fluid": "water",
            "shapes": [
                {"sphere": {"centre": [8e-5, 1e-4], "radius": 6e-5}, "is": "oil"},
                {"sphere": {"centre": [2.4e-4, 0], "radius": 6e-5}, "is": "solid"},
                {"sphere": {"centre": [2.4e-4, 2e-4], "radius": 6e-5}, "is": "solid"},
            ],
        },
        "particles": {"spacing": spacing},
        "fluids": {"oil": {"density": 850, "viscosity": 5e-3}, "water": {"density": 1000, "viscosity": 1e-3}},
        "interface": {"tension": 0.03, "contact_angle": 120},
        "drive": {"pressure_drop": {"x": 200}},
        "time": {"end": end},
    }
    found = isphcli.run(case, quiet=quiet)
    if not quiet:
        print(found)
        oil = [row["centre_x_oil"] for row in found.history]
        print(f"the oil went from x = {oil[0]:.3g} m to {oil[-1]:.3g} m")
        found.plot().save("drop_in_throat.png")
    return found


if __name__ == "__main__":
    main()
