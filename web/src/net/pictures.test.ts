import { describe, expect, it } from "vitest";
import type { PictureHeader, ViewName } from "../wire/messages";
import type { WirePicture } from "../wire/parse";
import { PictureBoard } from "./pictures";

/** Return a random generator with a fixed seed, so that a failure can be repeated. */
function randomOf(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state * 1664525 + 1013904223) % 2 ** 32;
    return state / 2 ** 32;
  };
}

function picture(
  frameId: number,
  poseId: number,
  view: ViewName = "airway",
  standsFor: ViewName | null = null,
): WirePicture {
  return {
    header: {
      frame_id: frameId,
      view,
      stands_for: standsFor,
      pose_id: poseId,
      lps_from_camera: null,
      fov_deg: null,
      lens: null,
      lps_from_pixel: null,
      lines: null,
      outline: null,
      width: 16,
      height: 16,
      step_vox: null,
      codec: "jpeg",
      quality: 85,
      full: false,
      empty: false,
      decorated: [],
      render_ms: 1,
      method: "leap",
    },
    payload: new Uint8Array(),
    outline: null,
    layers: [],
  };
}

/** Return a picture board whose decodes the test completes in any order. */
function board() {
  const drawn: PictureHeader[] = [];
  const acknowledged: number[] = [];
  const failures: number[] = [];
  const decodes: { frame: number; end: (fail?: boolean) => Promise<void> }[] = [];
  const made = new PictureBoard({
    decode: ({ header }) =>
      new Promise<{ close(): void }>((done, fail) => {
        decodes.push({
          frame: header.frame_id,
          end: async (broken = false) => {
            if (broken) fail(new Error("no image"));
            else done({ close: () => undefined });
            // Wait for two microtasks: the decode's completion, and the board's processing.
            await Promise.resolve();
            await Promise.resolve();
            await Promise.resolve();
          },
        });
      }),
    draw: (header) => drawn.push(header),
    acknowledge: (frameId) => acknowledged.push(frameId),
    failed: (header) => failures.push(header.frame_id),
  });
  return { made, drawn, acknowledged, failures, decodes };
}

describe("PictureBoard", () => {
  it("Pictures are drawn in order, and each is acknowledged after it was drawn.", async () => {
    const { made, drawn, acknowledged, decodes } = board();
    made.receive(picture(1, 1));
    expect(acknowledged).toEqual([]);
    await decodes[0]?.end();
    made.receive(picture(2, 2));
    await decodes[1]?.end();
    expect(drawn.map((header) => header.frame_id)).toEqual([1, 2]);
    expect(acknowledged).toEqual([1, 2]);
  });

  it("Of the pictures received during a decode only the latest is drawn, and all are acknowledged.", async () => {
    const { made, drawn, acknowledged, decodes } = board();
    made.receive(picture(1, 1));
    made.receive(picture(2, 2));
    made.receive(picture(3, 3));
    expect(acknowledged).toEqual([]);
    await decodes[0]?.end();
    await decodes[1]?.end();
    expect(drawn.map((header) => header.frame_id)).toEqual([1, 3]);
    expect(acknowledged).toEqual([1, 2, 3]);
  });

  it("A picture of an older pose is not drawn, but a later picture of the same pose is.", async () => {
    const { made, drawn, acknowledged, decodes } = board();
    made.receive(picture(5, 9));
    await decodes[0]?.end();
    made.receive(picture(6, 8));
    made.receive(picture(7, 9));
    await decodes[1]?.end();
    expect(drawn.map((header) => header.frame_id)).toEqual([5, 7]);
    expect(acknowledged).toEqual([5, 6, 7]);
  });

  it("A decode in one view does not delay the pictures of another view.", async () => {
    const { made, drawn, decodes } = board();
    made.receive(picture(1, 5, "airway"));
    made.receive(picture(2, 3, "axial"));
    await decodes[1]?.end();
    expect(drawn.map((header) => header.view)).toEqual(["axial"]);
  });

  it("A picture that replaces another view's picture is ordered among the pictures of that view.", async () => {
    const { made, drawn, decodes } = board();
    made.receive(picture(1, 4, "airway"));
    await decodes[0]?.end();
    made.receive(picture(2, 9, "cut-plane"));
    await decodes[1]?.end();
    made.receive(picture(3, 5, "cut-plane", "airway"));
    await decodes[2]?.end();
    made.receive(picture(4, 4, "airway"));
    made.receive(picture(5, 6, "airway"));
    await decodes[3]?.end();
    expect(drawn.map((header) => header.frame_id)).toEqual([1, 2, 3, 5]);
  });

  it("A picture that cannot be decoded is acknowledged and reported, and the next one is drawn.", async () => {
    const { made, drawn, acknowledged, failures, decodes } = board();
    made.receive(picture(1, 1));
    await decodes[0]?.end(true);
    made.receive(picture(2, 2));
    await decodes[1]?.end();
    expect(failures).toEqual([1]);
    expect(drawn.map((header) => header.frame_id)).toEqual([2]);
    expect(acknowledged).toEqual([1, 2]);
  });

  it("A picture received before a reset is not drawn after the reset.", async () => {
    const { made, drawn, decodes } = board();
    made.receive(picture(90, 90));
    made.reset();
    made.receive(picture(1, 1));
    await decodes[1]?.end();
    await decodes[0]?.end();
    expect(drawn.map((header) => header.frame_id)).toEqual([1]);
  });

  it("Poses are drawn in ascending order for random delays of network and decoder, with view finder pictures between.", async () => {
    const random = randomOf(7);
    for (let round = 0; round < 60; round += 1) {
      const { made, drawn, acknowledged, decodes } = board();
      let ended = 0;
      for (let frame = 1; frame <= 25; frame += 1) {
        const pose = Math.max(1, frame - Math.floor(4 * random()));
        made.receive(random() < 0.3 ? picture(frame, pose, "cut-plane", "airway") : picture(frame, pose));
        while (ended < decodes.length && random() < 0.5) {
          await decodes[ended]?.end(random() < 0.1);
          ended += 1;
        }
      }
      while (ended < decodes.length) {
        await decodes[ended]?.end();
        ended += 1;
      }
      const poses = drawn.map((header) => header.pose_id);
      expect(poses).toEqual([...poses].sort((a, b) => a - b));
      expect([...acknowledged].sort((a, b) => a - b)).toEqual(Array.from({ length: 25 }, (_, index) => index + 1));
    }
  });
});
