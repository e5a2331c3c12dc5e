"""The transfer-matrix method against another package, a recursion, and closed forms."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.lens.coatings.thin_films import film_coefficients

with open("tests/golden/thin_films_of_tmm.json", encoding="utf-8") as file:
    CASES = json.load(file)["cases"]

films = st.lists(st.tuples(st.floats(1.2, 3.0), st.floats(0.0, 2.0), st.floats(0.0, 0.4)), max_size=5)


def snell(n1, cosine, n2):
    """Cosine of the angle in another medium."""
    return np.sqrt(1.0 - (n1 / n2) ** 2 * (1.0 - cosine**2) + 0j)


def by_recursion(n_front, n_behind, indices, thicknesses_um, cosine, wavelength_um):
    """Amplitudes by Rouard's recursion over multiple reflections, from the substrate."""
    media = [n_front, *indices, n_behind]
    cosines = [snell(n_front, cosine, n) for n in media]
    results = []
    for p in (False, True):

        def fresnel(i, p=p):
            a = media[i] * cosines[i + p], media[i + 1] * cosines[i + 1 - p]
            if p:
                a = media[i + 1] * cosines[i], media[i] * cosines[i + 1]
                r = (a[1] - a[0]) / (a[1] + a[0])
                return r, 2.0 * media[i] * cosines[i] / (a[0] + a[1])
            return (a[0] - a[1]) / (a[0] + a[1]), 2.0 * a[0] / (a[0] + a[1])

        r, t = fresnel(len(indices))
        for i in range(len(indices) - 1, -1, -1):
            across = np.exp(2j * np.pi / wavelength_um * indices[i] * cosines[i + 1] * thicknesses_um[i])
            r1, t1 = fresnel(i)
            t = t1 * t * across / (1.0 + r1 * r * across**2)
            r = (r1 + r * across**2) / (1.0 + r1 * r * across**2)
        flux = np.sqrt((n_behind * cosines[-1] / (n_front * cosine)).real)
        results.append((t * flux, r))
    return results


@pytest.mark.parametrize("case", CASES)
def test_coefficients_are_those_of_another_package(case):
    cosine = np.cos(np.radians(case["incidence_deg"]))
    indices = np.array(case["n"]) + 1j * np.array(case["k"])
    found = film_coefficients(
        case["n_front"], case["n_behind"], indices, case["thickness_um"], cosine, case["wavelength_um"]
    )
    behind = snell(case["n_front"], cosine, case["n_behind"]).real
    flux = np.sqrt(case["n_behind"] * behind / (case["n_front"] * cosine))
    for own, sign, t, r in (("s", 1.0, found.ts, found.rs), ("p", -1.0, found.tp, found.rp)):
        assert t == pytest.approx(complex(*case[own]["t"]) * flux, abs=1e-12)
        assert r == pytest.approx(sign * complex(*case[own]["r"]), abs=1e-12)
        assert abs(t) ** 2 == pytest.approx(case[own]["T"], abs=1e-12)


@given(films, st.floats(0.05, 1.0), st.floats(1.0, 2.0), st.floats(1.0, 2.0), st.floats(0.35, 1.1))
def test_coefficients_are_those_of_a_recursion(layers, cosine, n_front, n_behind, wavelength_um):
    if (n_front / n_behind) ** 2 * (1.0 - cosine**2) > 0.999:
        return
    indices = [complex(n, k) for n, k, _ in layers]
    thicknesses = [d for *_, d in layers]
    given_ = (n_front, n_behind, indices, thicknesses, cosine, wavelength_um)
    found, ((ts, rs), (tp, rp)) = film_coefficients(*given_), by_recursion(*given_)
    assert np.abs(np.subtract(found, (ts, tp, rs, rp))).max() < 1e-9


@given(films, st.floats(0.05, 1.0), st.floats(1.0, 2.0))
def test_no_light_is_created_and_none_lost_without_absorption(layers, cosine, n_behind):
    thicknesses = [d for *_, d in layers]
    for absorbs in (False, True):
        indices = [complex(n, k if absorbs else 0.0) for n, k, _ in layers]
        found = film_coefficients(1.0, n_behind, indices, thicknesses, cosine, 0.55)
        for t, r in ((found.ts, found.rs), (found.tp, found.rp)):
            total = abs(t) ** 2 + abs(r) ** 2
            assert total <= 1.0 + 1e-12 if absorbs else total == pytest.approx(1.0, abs=1e-12)


@given(films, st.floats(0.3, 1.0), st.floats(1.0, 2.0))
def test_transmission_is_the_same_both_ways(layers, cosine, n_behind):
    indices, thicknesses = [complex(n, k) for n, k, _ in layers], [d for *_, d in layers]
    forward = film_coefficients(1.0, n_behind, indices, thicknesses, cosine, 0.55)
    inside = float(snell(1.0, cosine, n_behind).real)
    backward = film_coefficients(n_behind, 1.0, indices[::-1], thicknesses[::-1], inside, 0.55)
    assert np.abs(np.subtract(backward[:2], forward[:2])).max() < 1e-12


def test_a_quarter_wave_and_brewster_s_angle():
    n, film = 1.7, 1.38
    found = film_coefficients(1.0, n, [film], [0.25 * 0.55 / film], 1.0, 0.55)
    assert abs(found.rs) ** 2 == pytest.approx(((n - film**2) / (n + film**2)) ** 2, abs=1e-14)
    brewster = np.cos(np.arctan(n))
    bare = film_coefficients(1.0, n, [], [], brewster, 0.55)
    assert abs(bare.rp) < 1e-14 < abs(bare.rs)


def test_beyond_total_reflection_nothing_is_transmitted():
    found = film_coefficients(1.5, 1.0, [1.38], [0.1], np.cos(np.radians(60.0)), 0.55)
    assert (abs(found.ts), abs(found.tp)) == (0.0, 0.0)
    assert [abs(found.rs), abs(found.rp)] == pytest.approx([1.0, 1.0], abs=1e-12)


def test_arrays_are_broadcast():
    cosines = np.linspace(0.5, 1.0, 5)
    together = film_coefficients(
        1.0, np.array([[1.5], [1.8]]), [1.38], [np.array([[0.1], [0.2]])], cosines, 0.5
    )
    assert together.ts.shape == (2, 5)
    alone = film_coefficients(1.0, 1.8, [1.38], [0.2], cosines[3], 0.5)
    assert together.rp[1, 3] == pytest.approx(alone.rp, abs=1e-15)


def test_a_film_that_no_light_passes_reflects_as_a_medium():
    """Of 5 um of a metal, where exp(k d) would overflow, only the surface counts."""
    for cosine in (1.0, 0.6):
        thick = film_coefficients(1.0, 1.5, [1.0 + 20.0j], [5.0], cosine, 0.55)
        film = film_coefficients(1.0, 1.5, [1.0 + 20.0j], [0.2], cosine, 0.55)
        assert np.all(np.isfinite(thick))
        assert max(abs(thick.ts), abs(thick.tp)) < 1e-300
        assert np.abs(np.subtract(thick[2:], film[2:])).max() < 1e-12
