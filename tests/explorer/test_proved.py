"""What is proved, as a layer of the map."""

import numpy as np
import pytest

from capsyn import Box, subdivide
from capsyn.cells.run_lengths import run_lengths
from capsyn.explorer.page_data import page_data
from support.explorer.node import BEGIN, node
from support.explorer.page import OUTPUT, synthesized
from support.policy_files import full
from support.proofs.certificates import by_hand, complete
from support.relays import relay

COVERS = {2: ((123, 132, 144), 225), 3: ((192, 57, 43), 225), 0: ((255, 255, 255), 165)}
"""Colour and opacity of 255 of what lies over a cell on a light page, by what is known of it."""


def proved(policy, counts, make=by_hand, **changes):
    """Return a policy with a certificate in its evidence."""
    certificate = make(policy.domain, counts, **changes)
    return policy.with_evidence(certificate=certificate.evidence())


def box_policy(n):
    box = Box([-1.0] * n, [1.0] * n, names=["a", "b", "c"][:n])
    return subdivide(lambda x: (x[:, 0] > 0.2).astype(int), box, 2, partitions=2, max_level=2)


def assert_covers(shown, certificate, count=400):
    """Check the colours at random pixels: those without the layer, under what is known there."""
    shares = np.random.default_rng(2).uniform(0.001, 0.999, (count, 2))
    shown.page.uncheck("#proved")
    plain, states = shown.colors(shares)
    shown.page.check("#proved")
    pixels, _ = shown.colors(shares)
    cells = certificate.cells
    turned = np.mod(states - cells.domain.lower, cells.domain.periods, where=cells.domain.periodic,
                    out=states - cells.domain.lower)  # fmt: skip
    places = np.floor(turned / cells.domain.widths * cells.counts).astype(int).T
    known = cells.statuses()[np.ravel_multi_index(places, cells.counts)]
    wanted = plain.astype(float)
    for status, (color, opacity) in COVERS.items():
        some = known == status
        wanted[some] += (color - wanted[some]) * opacity / 255
    right = (np.abs(pixels - wanted) <= 2).all(axis=1)
    assert right.mean() > 0.9  # but for lines, crosses and their names
    assert all(right[known == status].mean() > 0.9 for status in {0, 1, 2} & {*known.tolist()})


def test_the_page_is_told_the_map_only():
    policy = proved(synthesized("double-tank-a"), (20, 20))
    told = page_data(policy)["proved"]
    evidence = policy.evidence["certificate"]
    assert told == {
        **evidence["map"], "ripple": evidence["ripple"], "refuted": evidence["refuted"],
    }  # fmt: skip


def test_a_page_without_a_map_has_no_layer(show):
    plain = synthesized("double-tank-a")
    assert page_data(plain)["proved"] is None
    figures = by_hand(plain.domain, (20, 20)).to_json()
    assert page_data(plain.with_evidence(certificate=figures))["proved"] is None
    shown = show(plain)
    assert shown.page.locator("#proved").count() == 0
    shown.page.keyboard.press("p")
    assert shown.state["proved"] is False


def test_a_map_of_other_states_is_not_shown():
    policy = full()
    other = Box([0] * 5, [1] * 5)
    assert policy.domain.n != 5
    told = policy.with_evidence(certificate=complete(other, (4,) * 5).evidence())
    assert page_data(told)["proved"] is None


def test_runs_are_read_as_they_are_written(tmp_path):
    code = (
        'import { unpackRuns } from "#page/policy/packed.js";'
        + BEGIN
        + "print([...unpackRuns(input.runs, input.count)]);"
    )
    values = np.repeat([1, 0, 7, 3, 5], [3, 20, 3000, 1, 300_000])
    inputs = {"runs": run_lengths(values), "count": len(values)}
    assert node(tmp_path, code, synthesized("double-tank-a"), **inputs) == values.tolist()


@pytest.mark.parametrize("name", ["double-tank-a", "cart-pendulum"])
def test_what_is_not_proved_is_covered(show, name):
    policy = synthesized(name)
    certificate = by_hand(policy.domain, (30, 20))
    shown = show(proved(policy, (30, 20)), color_scheme="light")
    assert shown.state["proved"] is False and not shown.page.is_visible("#legend .proof")
    shown.page.uncheck("#outlines")
    assert_covers(shown, certificate)
    assert shown.text("#legend").split("\n")[-4:] == ["open", "refuted", "stays in", "ripple"]
    OUTPUT.mkdir(parents=True, exist_ok=True)
    shown.page.screenshot(path=OUTPUT / f"{name}-proved.png")
    shown.page.focus("#map")
    for _ in range(3):
        shown.page.keyboard.press("+")
    assert_covers(shown, certificate)


def test_the_layer_goes_round_a_periodic_axis(show):
    policy = synthesized("cart-pendulum")
    shown = show(proved(policy, (30, 20)), color_scheme="light")
    shown.page.uncheck("#outlines")
    shown.page.focus("#map")
    for _ in range(40):
        shown.page.keyboard.press("ArrowRight")
    assert shown.state["bounds"][0] > 1
    assert_covers(shown, by_hand(policy.domain, (30, 20)))


def test_the_key_turns_it_on_and_off(show):
    shown = show(proved(synthesized("double-tank-a"), (20, 20)))
    shown.page.keyboard.press("p")
    assert shown.state["proved"] and shown.page.is_checked("#proved")
    shown.page.keyboard.press("p")
    assert not shown.state["proved"] and not shown.page.is_checked("#proved")


def test_more_states_show_the_slice(show):
    policy = box_policy(3)
    certificate = by_hand(policy.domain, (20, 10, 8))
    shown = show(proved(policy, (20, 10, 8)), color_scheme="light")
    shown.page.uncheck("#outlines")
    for value in (0.1, 0.7):
        shown.slide("#slice-2", value)
        assert_covers(shown, certificate)
    shown.page.select_option("#axis-x", "2")
    assert shown.state["axes"] == [2, 1]
    shown.slide("#slice-0", 0.6)
    assert_covers(shown, certificate)


def test_one_state_is_a_strip(show):
    policy = box_policy(1)
    shown = show(proved(policy, (40,)), color_scheme="light")
    shown.page.uncheck("#outlines")
    before, states = shown.colors(np.array([[0.02, 0.5], [0.33, 0.2], [0.8, 0.5]]))
    shown.page.check("#proved")
    pixels, _ = shown.colors(np.array([[0.02, 0.5], [0.33, 0.2], [0.8, 0.5]]))
    assert (pixels[0] > before[0]).any() and (pixels[1] == before[1]).all()
    assert np.abs(pixels[2] - (before[2] + (COVERS[2][0] - before[2]) * 225 / 255)).max() <= 2


def test_a_plane_of_exogenous_inputs_has_no_layer(show):
    policy = relay(
        lambda x, u, w: [u[0]],
        Box([-1.0], [1.0]),
        lambda z: (z[:, 0] > z[:, 1]).astype(int),
        exogenous=Box([-0.5], [0.5], names=["goal"]),
        partitions=[4, 2],
        max_level=2,
    )
    shown = show(proved(policy, (20,)))
    shares = np.random.default_rng(0).uniform(0.1, 0.9, (50, 2))
    before, _ = shown.colors(shares)
    shown.page.check("#proved")
    assert (shown.colors(shares)[0] == before).all()


def test_names_of_failures_are_only_text(show):
    hostile = "<img src=x onerror=alert(1)>"
    shown = show(proved(synthesized("double-tank-a"), (20, 20), failures=(hostile,)))
    shown.page.check("#proved")
    assert shown.state["proved"] and shown.messages == []
