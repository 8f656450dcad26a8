"""Test of the scope in the lumen: placed on the route, bent, stopped by the wall, with contact feedback."""

from __future__ import annotations

import pytest
from test_devices import MOCK, hold

pytestmark = pytest.mark.browser

WALL_MS = 900_000
"""Limit for computing the wall distances of a case, ms; on two busy cores this takes about a minute."""
FLIGHT_MS = 300_000
"""Limit for a movement of the scope, ms."""


def test_simulated_scope_in_the_lumen_bends_and_is_stopped_by_the_wall_until_scope_mode_ends(server, workstation):
    page = workstation.page
    page.add_init_script(MOCK)
    workstation.open(server)
    workstation.wait_ready()
    hold(workstation, (0, 0, 0, 0))
    # The wall is computed first; its progress is shown and the picture stays. The progress disappears with the job,
    # possibly between two checks of the test, so the page records it.
    page.evaluate(
        """() => new MutationObserver(() => {
            window.preparing ||= document.body.textContent.toLowerCase()
                .includes('preparing the airway wall for the scope');
        }).observe(document.body, { subtree: true, childList: true, characterData: true })"""
    )
    page.get_by_role("radio", name="Scope").click()
    page.wait_for_function("() => window.preparing === true")
    workstation.picture("held-scope-waiting")
    page.wait_for_function("() => window.__carina.state.pose.mode === 'scope'", timeout=WALL_MS)
    page.get_by_test_id("scope-reading").wait_for()
    for width, height in ((1280, 720), (1440, 900)):
        page.set_viewport_size({"width": width, "height": height})
        workstation.wait_still()
        workstation.picture(f"held-scope-laid-{width}")
        heights = page.locator(".scope-reading > span").evaluate_all(
            "(lines) => lines.map((line) => line.offsetHeight)"
        )
        assert len(heights) == 2
        assert max(heights) < 25, "each reading is one line"
    assert workstation.state("pose.scope.num_contacts") == 0
    assert workstation.state("pose.inside") is True

    # The key moves the scope forward and the arrow bends the tip up: the picture shows both.
    start_mm, pixels = workstation.state("pose.scope.insertion_mm"), workstation.pixels("airway")
    workstation.hold_until("w", f"() => window.__carina.state.pose.scope.insertion_mm > {start_mm + 8}")
    workstation.hold_until("ArrowUp", "() => window.__carina.state.pose.scope.flexion_rad > 0.2")
    workstation.wait_still()
    assert workstation.frame_answers("airway", workstation.state("pose.pose_id"))
    assert workstation.pixels("airway") != pixels
    workstation.picture("held-scope-bent")

    # The gamepad pushes the bent tip forward: the wall stops it, the contact is counted, the pad vibrates, and the lens
    # turns red.
    assert page.evaluate("() => window.testRumble.length") == workstation.state("pose.scope.num_contacts")
    contacts = workstation.state("pose.scope.num_contacts")
    hold(workstation, (0, -1, 0, -1))
    page.wait_for_function(
        f"() => window.__carina.state.pose.scope.num_contacts > {contacts} && window.testRumble.length > {contacts}",
        timeout=FLIGHT_MS,
    )
    hold(workstation, (0, 0, 0, 0))
    workstation.wait_still()
    workstation.picture("held-scope-touching")
    assert page.get_by_text("wall contacts").count() >= 1

    # After the scope is withdrawn, straightened and released, the path continues from its position without a jump.
    hold(workstation, (0, 1, 0, 0))
    page.wait_for_function(f"() => window.__carina.state.pose.scope.insertion_mm < {start_mm + 2}", timeout=FLIGHT_MS)
    hold(workstation, (0, 0, 0, 0))
    workstation.wait_still()
    before = workstation.state("pose.lps_from_camera")
    page.get_by_role("radio", name="Free").click()
    page.wait_for_function("() => window.__carina.state.pose.mode === 'free'")
    assert workstation.state("pose.scope") is None
    assert workstation.state("pose.lps_from_camera") == pytest.approx(before, abs=1e-9)
    workstation.picture("held-scope-let-go")

    # The step Rehearse places the scope at the start again, now with the known wall; then a second time.
    page.get_by_role("button", name="Rehearse", exact=True).click()
    for _ in range(2):
        page.get_by_test_id("rehearse").click()
        # The rigid tip, about 3 mm long, is in the lumen from the beginning.
        page.wait_for_function("() => window.__carina.state.pose.scope?.insertion_mm < 4")
        workstation.wait_still()
        assert workstation.state("pose.mode") == "scope"
        assert workstation.state("pose.scope.num_contacts") == 0
        workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 6")
    page.get_by_test_id("score").wait_for()
    workstation.picture("held-scope-rehearsed")
    assert workstation.faults == []
