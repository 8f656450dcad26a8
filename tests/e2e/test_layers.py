"""Tests of structures around a target in the browser: requested, stopped, requested again, hidden and shown.

The file also tests that the drive of a verdict is stored as a flight and flown.
"""

from __future__ import annotations

import pytest

from cached_test_data import cached_phantom

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.4, "generations": 5, "nodule": True}
"""Options of a chest that is coarse, because finding all structures around a target is the longest job."""
LAYERS = ("vessels", "fissures", "lobes", "stations")
"""Layers that are hidden and shown over the slices."""


@pytest.fixture
def opens(shared_chest):
    """Return a chest with a nodule, as the opened file."""
    return shared_chest(**CHEST)


def mark_the_nodule(workstation) -> None:
    """Set a target at the nodule by typing its coordinates, as a user reads them from a report."""
    x, y, z = cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    page = workstation.page
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("coordinates").locator("input").fill(f"{x:.1f}, {y:.1f}, {z:.1f}")
    page.get_by_role("button", name="Add", exact=True).click()
    assert page.get_by_test_id("coordinates").locator("input").input_value() == ""
    workstation.wait_for("window.__carina.state.plans.targets[0].routes.length > 0")


def switch(workstation, layer: str, *, on: bool) -> None:
    """Switch a layer on or off, and wait until its lines are added to or removed from the coronal picture."""
    # A picture that was requested before an earlier switch may still be on its way, and would look like this change.
    has_layer = f"(window.__carina.state.frames.coronal.layers ?? []).some((one) => one.layer === '{layer}')"
    workstation.wait_for(f"{has_layer} === {str(not on).lower()}")
    workstation.refreshes(3)
    before = workstation.overlay("coronal")
    workstation.page.get_by_test_id(f"show-{layer}").click()
    workstation.wait_for("(before) => document.querySelector('[data-overlay=coronal]').toDataURL() !== before", before)


def test_computation_of_vessel_and_lobe_layers_is_stopped_and_repeated_and_layers_are_switched_off_and_on(
    server, workstation
):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    mark_the_nodule(workstation)
    plain, plain_tree = workstation.overlay("coronal"), workstation.overlay("tree")
    ask = page.get_by_test_id("map-lungs")

    ask.click()
    workstation.wait_for("window.__carina.state.jobs.some((job) => job.what === 'looking for vessels')")
    workstation.wait_for("window.__carina.state.lungs.standing === 'making'")
    assert ask.is_disabled()
    job = page.get_by_role("group", name="mapping the structures around the target")
    # The message appears at once and disappears with the job, possibly between two checks of the test, so the page
    # records it.
    page.evaluate(
        """() => new MutationObserver(() => {
            window.cancelling ||= document.querySelector('.jobs').textContent.includes('Cancelling');
        }).observe(document.querySelector('.jobs'), { subtree: true, childList: true, characterData: true })"""
    )
    job.get_by_role("button", name="Cancel", exact=True).click()
    workstation.wait_for("window.cancelling")
    workstation.wait_for("window.__carina.state.lungs.standing === 'stopped'")
    workstation.wait_for("window.__carina.state.jobs.length === 0")
    assert workstation.state("lungs.layers") == []
    assert workstation.overlay("coronal") == plain

    ask.click()
    workstation.wait_while_working("window.__carina.state.lungs.standing === 'had'")
    ask.wait_for(state="detached")
    rows = page.locator(".layers > li")
    assert [row.get_attribute("data-testid") for row in rows.all()] == [f"layer-{layer}" for layer in LAYERS]
    assert page.get_by_test_id("parts-lobes").locator("li").all_inner_texts() == ["RUL", "RML", "RLL", "LUL", "LLL"]
    assert "Dashed: less sure" in page.get_by_test_id("lungs-limit").inner_text()
    # The same vessels are drawn as lines in the view of the tree, after the message with the layers.
    assert len(workstation.state("lungs.vessels")) > 20
    workstation.wait_for("(plain) => document.querySelector('[data-overlay=tree]').toDataURL() !== plain", plain_tree)
    bushy = workstation.overlay("tree")
    page.get_by_test_id("show-vessels").click()
    workstation.wait_for("(bushy) => document.querySelector('[data-overlay=tree]').toDataURL() !== bushy", bushy)
    page.get_by_test_id("show-vessels").click()
    workstation.wait_for("(bushy) => document.querySelector('[data-overlay=tree]').toDataURL() === bushy", bushy)
    workstation.picture("layers")

    # On a busy machine the lines may reach the slices after the tree.
    workstation.wait_for("(plain) => document.querySelector('[data-overlay=coronal]').toDataURL() !== plain", plain)
    for layer in ("vessels", "lobes"):
        switch(workstation, layer, on=False)
    # These structures may be absent in the slice.
    for layer in ("fissures", "stations"):
        page.get_by_test_id(f"show-{layer}").click()
    workstation.wait_for("(plain) => document.querySelector('[data-overlay=coronal]').toDataURL() === plain", plain)
    for layer in ("vessels", "lobes"):
        switch(workstation, layer, on=True)
    assert workstation.faults == []


def test_simulated_drive_of_a_verdict_is_stored_as_a_flight_and_flown(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    mark_the_nodule(workstation)
    page.get_by_test_id("take-route").click()
    workstation.wait_while_working("window.__carina.state.plans.verdicts_standing === 'had'")
    # The step is scrolled to its top, with the routes side by side.
    assert page.locator(".step-body").evaluate("(body) => body.scrollTop") == 0
    scope = next(one["scope"] for one in workstation.state("plans.verdicts") if one["was_driven"])
    keep = page.get_by_test_id(f"keep-drive-{scope}")
    if keep.count() == 0:
        page.get_by_test_id("all-verdicts").click()
    page.get_by_test_id("verdict").filter(has=keep).locator("summary").click()
    keep.click()
    workstation.wait_for("window.__carina.state.flights.length === 1")
    (flight,) = workstation.state("flights")
    assert flight["name"].startswith("Simulated drive to Target 1")

    page.get_by_role("button", name="Rehearse", exact=True).first.click()
    page.get_by_test_id("flight-play").click()
    workstation.wait_for("window.__carina.state.replaying.on && window.__carina.state.pose.flight.time_s > 0")
    workstation.picture("layers-drive-flown")
    # A long drive is not flown to its end: a movement of the user interrupts it.
    workstation.hold("s", 100)
    workstation.wait_for("!window.__carina.state.replaying.on && window.__carina.state.pose.flight === null")
    assert workstation.faults == []
