"""Sphere pack: permeability and formation factor of spheres in a periodic box, beside the formula of Kozeny and Carman.

    python examples/sphere_pack.py
"""

import isphcli


def kozeny_carman(porosity: float, diameter: float) -> float:
    """Permeability of a random pack of equal spheres, m2 (Carman 1937, with the constant 180)."""
    return diameter**2 * porosity**3 / (180 * (1 - porosity) ** 2)


def main(count: int = 60, per_diameter: float = 8.0, quiet: bool = False) -> isphcli.RunResult:
    """`count` spheres of 0.2 mm at random in a cube that repeats, a third of it solid."""
    diameter = 2e-4
    edge = (count * 3.14159265 / 6 / 0.3) ** (1 / 3) * diameter
    case = {
        "title": f"{count} spheres at random",
        "geometry": {
            "box": [edge] * 3,
            "periodic": ["x", "y", "z"],
            "shapes": [{"spheres": {"random": count, "radius": diameter / 2, "seed": 1}, "is": "solid"}],
        },
        "particles": {"spacing": edge / round(edge / diameter * per_diameter)},
        "fluids": {"water": {"density": 1000, "viscosity": 1e-3}},
        "flow": "stokes",
        "drive": {"axes": ["x"]},
        "measure": ["formation_factor"],
    }
    found = isphcli.run(case, quiet=quiet)
    if not quiet:
        print(found)
        print(f"Kozeny and Carman: {kozeny_carman(found.porosity, diameter):.3g} m2")
        found.plot().save("sphere_pack.png")
    return found


if __name__ == "__main__":
    main()
