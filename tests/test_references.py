"""Every reference a second way: another formula, the equation it solves, a table, or a limit."""

import math

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.interpolate import CubicSpline

from isphcli import references as ref

Y = np.linspace(0, 1, 2001)
DY = Y[1]


def second_derivative(f, h):
    return (f[2:] - 2 * f[1:-1] + f[:-2]) / h**2


# -- plates ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["couette", "poiseuille"])
def test_startup_flows_against_the_tables(name):
    """The tables hold ten digits; Crank-Nicolson confirmed them to 1e-6 of the maximum."""
    columns = ref.table(f"startup_{name}_morris")
    y = columns.pop("y_m")
    for key, expected in columns.items():
        t = float(key.removeprefix("u_t").removesuffix("s"))
        drive = 1.25e-5 if name == "couette" else 1e-4
        function = ref.startup_couette if name == "couette" else ref.startup_poiseuille
        assert np.allclose(function(y, t, 1e-3, 1e-6, drive), expected, rtol=1e-8, atol=1e-15)


def test_startup_begins_at_rest_and_ends_steady():
    inner = Y[100:-100]
    # 400 terms of a series that falls as 1/n: the ripple near the moving wall is 1/(400 pi 0.05)
    assert np.abs(ref.startup_couette(inner, 0.0, 1, 1, 1)).max() < 0.02
    assert np.abs(ref.startup_poiseuille(inner, 0.0, 1, 1, 1)).max() < 1e-6
    assert np.allclose(ref.startup_couette(Y, 9.0, 1, 1, 1), ref.plane_couette(Y, 1, 1))
    assert np.allclose(ref.startup_poiseuille(Y, 9.0, 1, 1, 1), ref.slit_poiseuille(Y, 1, 1, 1))
    assert math.isclose(simpson(ref.slit_poiseuille(Y, 1, 1, 1), dx=DY), ref.slit_permeability(1))


@pytest.mark.parametrize("omega", [0.01, 3.0, 400.0])
def test_oscillating_flows_solve_their_equation(omega):
    """du/dt = F cos(omega t) + nu u'' and the walls' velocity, by differences (second order, 2000 cells)."""
    nu, t, dt = 0.7, 0.4, 1e-4 / omega
    for function, force in ((ref.oscillating_slit, 1.0), (ref.oscillating_wall, 0.0)):
        u = function(Y, t, 1.0, nu, 1.0, omega)
        rate = (function(Y, t + dt, 1.0, nu, 1.0, omega) - function(Y, t - dt, 1.0, nu, 1.0, omega)) / (
            2 * dt
        )
        residual = rate[1:-1] - force * math.cos(omega * t) - nu * second_derivative(u, DY)
        assert np.abs(residual).max() < 1e-4 * max(1.0, omega)
        assert abs(u[0]) < 1e-12 and math.isclose(u[-1], (1 - force) * math.cos(omega * t), abs_tol=1e-12)
    slow = ref.oscillating_slit(Y, 0.0, 1.0, nu, 1.0, 1e-4)
    assert np.allclose(slow, ref.slit_poiseuille(Y, 1.0, 1.0, nu), rtol=1e-4, atol=1e-9)


def test_high_frequency_does_not_overflow():
    assert np.isfinite(ref.oscillating_slit(Y, 0.1, 1.0, 1e-9, 1.0, 1e3)).all()


def test_two_layers():
    u = ref.two_layer_couette(Y, 1.0, 0.4, (1.0, 10.0), 1.0)
    assert math.isclose(np.interp(0.4, Y, u), 0.86956522, rel_tol=1e-8)
    assert math.isclose(np.trapezoid(u, Y), 0.73478261, rel_tol=1e-7)
    u = ref.two_layer_poiseuille(Y, 1.0, 0.4, (1.0, 10.0), 2.0)
    below, above = Y[1:-1] < 0.3995, Y[1:-1] > 0.4005
    assert np.allclose(second_derivative(u, DY)[below], -2.0, atol=1e-6)
    assert np.allclose(second_derivative(u, DY)[above], -0.2, atol=1e-6)
    i = np.searchsorted(Y, 0.4)
    below, above = (3 * u[i] - 4 * u[i - 1] + u[i - 2]), (-3 * u[i] + 4 * u[i + 1] - u[i + 2])
    assert math.isclose(below, 10 * above, rel_tol=1e-6) and abs(u[0]) + abs(u[-1]) < 1e-15
    same = ref.two_layer_poiseuille(Y, 1.0, 0.3, (2.0, 2.0), 2.0)
    assert np.allclose(same, ref.slit_poiseuille(Y, 1.0, 2.0, 2.0))


# -- ducts -----------------------------------------------------------------------------------------------


def test_square_duct():
    assert math.isclose(ref.square_duct_flux(2.0, 1.0, 1.0), 0.56230806, rel_tol=1e-7)
    g = np.linspace(0, 1, 201)
    y, z = np.meshgrid(g, g, indexing="ij")
    u = ref.square_duct(y.ravel(), z.ravel(), 1.0, 1.0, 1.0).reshape(201, 201)
    assert np.abs(u - u.T).max() < 2e-7  # the series treats y and z differently; its tail is 1e-7 at a wall
    assert max(np.abs(u[[0, -1]]).max(), np.abs(u[:, [0, -1]]).max()) < 2e-7
    assert math.isclose(
        simpson(simpson(u, dx=g[1]), dx=g[1]), ref.square_duct_flux(1.0, 1.0, 1.0), rel_tol=1e-5
    )
    assert math.isclose(u[100, 100] / ref.square_duct_flux(1.0, 1.0, 1.0), 2.096256, rel_tol=1e-5)


def test_annulus():
    r = np.linspace(0.3, 1.0, 2001)
    u = ref.annulus(r, 0.3, 1.0, 2.0, 0.5)
    assert abs(u[0]) + abs(u[-1]) < 1e-14
    assert math.isclose(simpson(2 * math.pi * r * u, x=r), ref.annulus_flux(0.3, 1.0, 2.0, 0.5), rel_tol=1e-9)
    flux = np.diff(u) / np.diff(r) * (r[1:] + r[:-1]) / 2
    assert np.allclose(np.diff(flux) / np.diff(r[1:]) / r[1:-1], -4.0, rtol=1e-6)
    thin = ref.annulus_flux(0.99, 1.01, 1.0, 1.0)
    assert math.isclose(thin, 2 * math.pi * 0.02 * ref.slit_permeability(0.02), rel_tol=1e-4)
    # the core slows the flow only by 1 / ln: the pipe is the limit
    assert math.isclose(ref.annulus_flux(1e-30, 1.0, 1.0, 1.0), ref.pipe_flux(1.0, 1.0, 1.0), rel_tol=0.04)


def test_taylor_couette():
    r = np.linspace(1.0, 2.0, 2001)
    u = ref.taylor_couette(r, 1.0, 2.0, 3.0, -1.0)
    assert math.isclose(u[0], 3.0) and math.isclose(u[-1], -2.0)
    circulation = np.diff(r * u) / np.diff(r) / ((r[1:] + r[:-1]) / 2)  # curl: constant
    assert np.ptp(circulation) < 1e-9
    assert np.allclose(ref.taylor_couette(r, 1.0, 2.0, 0.5, 0.5), 0.5 * r)


# -- arrays ----------------------------------------------------------------------------------------------


def hasimoto(c):
    """Sangani and Acrivos (1982), eq. 57: Hasimoto's (1959) dilute expansion, carried on."""
    s = c ** (1 / 3)
    return 1 / (1 - 1.7601 * s + c - 1.5593 * c**2 + 3.9799 * s**8 - 3.0734 * s**10)


@pytest.mark.parametrize("fraction, expected", ref.ZICK_HOMSY)
def test_sphere_array_is_the_table(fraction, expected):
    rounding = 0.0005 if expected < 10 else 0.05
    drag = ref.sphere_array_drag(fraction)
    assert abs(drag - expected) < rounding + (2e-4 if fraction < 0.216 else 0)


@pytest.mark.parametrize("fraction", [1e-4, 1e-3, 8e-3, 0.027, 0.064])
def test_sphere_array_when_dilute(fraction):
    assert math.isclose(ref.sphere_array_drag(fraction), hasimoto(fraction), rel_tol=5e-5)


def test_sphere_array_between_the_entries():
    """The series is still good to about 0.3 % at 0.28; the drag rises; nothing jumps where they meet."""
    chi = (0.28 / (math.pi / 6)) ** (1 / 3)
    assert math.isclose(ref.sphere_array_drag(0.28), np.polyval(ref.SANGANI_ACRIVOS[::-1], chi), rel_tol=0.01)
    drag = [ref.sphere_array_drag(c) for c in np.linspace(0.01, 0.5236, 300)]
    assert (np.diff(drag) > 0).all()
    assert math.isclose(ref.sphere_array_drag(0.2158), ref.sphere_array_drag(0.2161), rel_tol=4e-3)
    assert math.isclose(
        ref.sphere_array_permeability(0.216, 2.0), 4 / (6 * math.pi * 7.442 * 0.37221), rel_tol=1e-4
    )
    for bad in (0.0, 0.6):
        with pytest.raises(ValueError, match="simple cubic"):
            ref.sphere_array_drag(bad)


@pytest.mark.parametrize(
    "fraction, expected",
    [(0.05, 15.56), (0.1, 24.83), (0.2, 51.53), (0.3, 102.90), (0.4, 217.89), (0.5, 532.55)],
)
def test_cylinder_array_is_the_published_table(fraction, expected):
    """Sangani and Acrivos (1982), table 1; its 102.90 is 0.02 % off its neighbours' pattern."""
    assert math.isclose(ref.cylinder_array_drag(fraction), expected, rel_tol=4e-4)


def test_cylinder_array_elsewhere():
    assert math.isclose(ref.cylinder_array_drag(0.2), 51.5269, abs_tol=1e-4)
    assert math.isclose(ref.cylinder_array_drag(math.pi * 0.2**2), 30.3506, abs_tol=1e-4)
    assert math.isclose(ref.cylinder_array_permeability(0.2, 3.0), 9 / 51.5269, rel_tol=1e-6)
    for c in (1e-4, 1e-3, 1e-2):  # the dilute expansion of the same paper, eq. 17
        dilute = 4 * math.pi / (-0.5 * math.log(c) - 0.738 + c - 0.887 * c**2 + 2.038 * c**3)
        assert math.isclose(ref.cylinder_array_drag(c), dilute, rel_tol=2e-4)
    with pytest.raises(ValueError, match=r"up to 0\.5"):
        ref.cylinder_array_drag(0.6)


# -- Taylor-Green ----------------------------------------------------------------------------------------


def test_taylor_green_2d_solves_navier_stokes():
    """Differences of second order on 1e-4 of a wavelength."""
    x, h, nu, rho = np.random.default_rng(0).random((50, 2)), 1e-4, 0.03, 3.0

    def at(dx=0.0, dy=0.0, t=0.2):
        return ref.taylor_green_2d(x + [dx, dy], t, nu, 1.5, 2 * math.pi, rho)

    u, _ = at()
    ux, uy = (at(h)[0] - at(-h)[0]) / (2 * h), (at(0, h)[0] - at(0, -h)[0]) / (2 * h)
    grad_p = np.stack([(at(h)[1] - at(-h)[1]) / (2 * h), (at(0, h)[1] - at(0, -h)[1]) / (2 * h)], axis=1)
    laplacian = (at(h)[0] + at(-h)[0] + at(0, h)[0] + at(0, -h)[0] - 4 * u) / h**2
    rate = (at(t=0.2 + h)[0] - at(t=0.2 - h)[0]) / (2 * h)
    residual = rate + u[:, :1] * ux + u[:, 1:] * uy + grad_p / rho - nu * laplacian
    assert np.abs(residual).max() < 1e-4 and np.abs(ux[:, 0] + uy[:, 1]).max() < 1e-4


def test_spectral_solver_on_the_exact_2d_vortex():
    g = 2 * math.pi * np.arange(8) / 8
    x, y, _ = np.meshgrid(g, g, g, indexing="ij")
    start = np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y), 0 * x])
    (field,) = ref.navier_stokes_spectral(start, [0.7], 0.1)
    assert math.isclose(ref.spectral_energy(field), 0.25 * math.exp(-4 * 0.1 * 0.7), rel_tol=1e-12)
    points = np.random.default_rng(0).random((2000, 3))
    exact, _ = ref.taylor_green_2d(points[:, :2], 0.7, 0.1 / (2 * math.pi) ** 2)
    u = ref.spectral_velocity(field, points)
    assert np.allclose(u[:, :2], exact * np.exp(0), atol=1e-12) and np.abs(u[:, 2]).max() < 1e-12


def test_taylor_green_3d():
    """Initial energy U^2/8 and dissipation 6 nu k^2 E; a finer grid agrees; units scale."""
    energy, fields = ref.taylor_green_3d([0.0, 0.01, 1.0], 0.02, k=1.0, n=16)
    finer, _ = ref.taylor_green_3d([1.0], 0.02, k=1.0, n=24)
    assert math.isclose(energy[0], 0.125, rel_tol=1e-14)
    assert math.isclose(energy[1], 0.125 * math.exp(-6 * 0.02 * 0.01), rel_tol=1e-6)
    assert math.isclose(energy[2], finer[0], rel_tol=1e-5)
    assert energy[2] < 0.99999 * 0.125 * math.exp(-6 * 0.02 * 1.0)  # and faster than the linear decay later
    # the same flow, 2 units long and at speed 3
    scaled, _ = ref.taylor_green_3d([1.0 / (3 * math.pi)], 0.02 * 3 / math.pi, 3.0, math.pi, n=16)
    assert math.isclose(scaled[0], 9 * energy[2], rel_tol=1e-10)
    points = np.array([[0.2, 0.4, 0.9]])
    sx, cx, sy, cy, cz = math.sin(0.2), math.cos(0.2), math.sin(0.4), math.cos(0.4), math.cos(0.9)
    assert np.allclose(ref.spectral_velocity(fields[0], points, 1.0), [[sx * cy * cz, -cx * sy * cz, 0]])


# -- cavity ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reynolds", [100, 400, 1000])
def test_cavity_passes_no_net_flux(reynolds):
    """What goes right above the centre goes left below it. Coarse tables: 1.5 % of the lid's speed."""
    c = ref.cavity(reynolds)
    for x, v in ((c["y"], c["u"]), (c["x"], c["v"])):
        assert x[0] == 0 and x[-1] == 1 and (np.diff(x) > 0).all() and len(x) == len(v)
        assert abs(CubicSpline(x, v).integrate(0, 1)) < 0.015


def test_cavity_without_the_misprint():
    c = ref.cavity(400)
    assert 0.9063 not in c["x"] and len(c["x"]) == 16 and len(c["y"]) == 17
    printed = ref.table("ghia_cavity_v")
    smooth = CubicSpline(c["x"], c["v"])(0.9063)
    assert abs(smooth - printed["400"][printed["x"] == 0.9063][0]) > 0.08
    for reynolds in (100, 1000):  # where nothing is wrong the same test finds nothing
        kept = printed["x"] != 0.9063
        left_out = CubicSpline(printed["x"][kept], printed[str(reynolds)][kept])(0.9063)
        assert abs(left_out - printed[str(reynolds)][~kept][0]) < 0.03
    with pytest.raises(KeyError):
        ref.cavity(200)


# -- drops and waves -------------------------------------------------------------------------------------


def test_laplace_jump():
    assert ref.laplace_jump(0.07, 0.5, 2) == 0.14 and ref.laplace_jump(0.07, 0.5, 3) == 0.28


@pytest.mark.parametrize("angle", [30.0, 60.0, 90.0, 150.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_drop_on_wall_has_its_size(dim, angle):
    """Area or volume by integrating the cap over its height."""
    drop = ref.drop_on_wall(1.7, angle, dim)
    z = np.linspace(0, drop["height"], 400001)
    half = np.sqrt(np.maximum(drop["radius"] ** 2 - (z + drop["radius"] - drop["height"]) ** 2, 0))
    size = np.trapezoid(2 * half if dim == 2 else math.pi * half**2, z)
    assert math.isclose(size, 1.7, rel_tol=1e-6) and math.isclose(2 * half[0], drop["base"], rel_tol=1e-6)


def test_capillary_wave_against_the_table():
    columns = ref.table("capillary_wave")
    tau, t, amplitude = columns.values()
    a = ref.capillary_wave(t, 1.0, 1.0, (1.0, 1.0), 0.0182571749236)
    assert np.abs(a - amplitude).max() < 1e-6
    fine = np.linspace(0.0, 0.8, 20001)
    a = ref.capillary_wave(fine, 1.0, 1.0, (1.0, 1.0), 0.0182571749236)
    zero = fine[1:][np.diff(np.sign(a)) != 0] * tau[1] / t[1]
    assert np.allclose(zero, [1.787, 5.264, 8.709], atol=1e-3)


def test_capillary_wave_without_viscosity():
    """cos(omega t), omega^2 = sigma k^3 / (rho1 + rho2), with gravity on unlike fluids too."""
    t = np.linspace(0, 1, 50)
    k = 2 * math.pi
    omega = math.sqrt(0.5 * k**3 / 4 + (3 - 1) / 4 * 9.81 * k)
    a = ref.capillary_wave(t, 1.0, 0.5, (3.0, 1.0), 1e-10, gravity=9.81)
    assert np.abs(a - np.cos(omega * t)).max() < 1e-3


def test_berea():
    """The published value took 2 um a voxel: Kx = 2.70891e-13 m2."""
    assert math.isclose(ref.berea_permeability(0, 2e-6), 2.70891e-13, rel_tol=1e-5)
    assert math.isclose(ref.berea_permeability(2, 3e-6), 0.0490182 * 9e-12, rel_tol=1e-12)


def test_profiles_have_names():
    assert all(callable(f) for f in ref.PROFILES.values())
