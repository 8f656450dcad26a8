import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { Viewport } from "../views/viewport";
import type { SetZoomMessage } from "../wire/messages";
import { flatPlacing } from "./gestures-flat";
import type { Workstation } from "./workstation";

/** Return the header of an axial picture of 200 x 100 pixels of 1 mm, whose middle is at this x (LPS mm). */
function pictureAt(x: number) {
  return {
    lps_from_camera: null,
    fov_deg: null,
    lens: null,
    lps_from_pixel: [1, 0, 0, x - 100, 0, 1, 0, -50, 0, 0, 1, 0, 0, 0, 0, 1],
    width: 200,
    height: 100,
  } as unknown as NonNullable<Viewport["header"]>;
}

function rig() {
  const sent: SetZoomMessage[] = [];
  const station = {
    state: { session: null },
    sendSoon: (message: SetZoomMessage) => sent.push(message),
  } as unknown as Workstation;
  const viewport = {
    view: "axial",
    header: pictureAt(0),
    wantedPixels: { width: 200, height: 100 },
    magnification: 1,
  } as unknown as Viewport;
  const show = (x: number) => Object.assign(viewport, { header: pictureAt(x) });
  return { placing: flatPlacing(station, viewport), show, middle: () => sent.at(-1)?.centre_lps?.[0] };
}

describe("pan of a planar view", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it("A drag pans by its whole distance while no new picture arrives.", () => {
    const { placing, middle } = rig();
    for (let move = 0; move < 6; move += 1) {
      placing.pan({ dx: 10, dy: 0 }, true);
      vi.advanceTimersByTime(1000);
    }
    expect(middle()).toBeCloseTo(-60, 9);
  });

  it("A drag pans by its whole distance while pictures of older positions arrive.", () => {
    const { placing, show, middle } = rig();
    for (let move = 0; move < 6; move += 1) {
      placing.pan({ dx: 10, dy: 0 }, true);
      vi.advanceTimersByTime(1000);
      show(-5 * move);
    }
    expect(middle()).toBeCloseTo(-60, 9);
  });

  it("A drag starts at the displayed position if the picture came to rest elsewhere after the last drag.", () => {
    const { placing, show, middle } = rig();
    placing.pan({ dx: 10, dy: 0 }, true);
    placing.release();
    show(30);
    vi.advanceTimersByTime(1000);
    placing.pan({ dx: 10, dy: 0 }, true);
    expect(middle()).toBeCloseTo(20, 9);
  });

  it("Each press of an arrow key pans further although no picture has arrived since the first press.", () => {
    const { placing, middle } = rig();
    for (let press = 0; press < 3; press += 1) {
      placing.pan({ dx: -40, dy: 0 });
      vi.advanceTimersByTime(1000);
    }
    expect(middle()).toBeCloseTo(120, 9);
  });
});
