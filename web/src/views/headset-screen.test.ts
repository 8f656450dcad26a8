import { describe, expect, it } from "vitest";
import type { XrSession, XrViewerPose } from "../input/devices/webxr";
import { inFrontOf, type LatestPicture, PictureScreen, product } from "./headset-screen";

const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

/** Return the matrix of a head at a place with a viewing angle, seen from above: 0 is -z, 90 degrees is to its left. */
function head(x: number, y: number, z: number, deg: number, upDeg = 0): Float32Array {
  const [c, s] = [Math.cos((deg * Math.PI) / 180), Math.sin((deg * Math.PI) / 180)];
  const [cu, su] = [Math.cos((upDeg * Math.PI) / 180), Math.sin((upDeg * Math.PI) / 180)];
  return new Float32Array([c, 0, -s, 0, s * su, cu, c * su, 0, s * cu, -su, c * cu, 0, x, y, z, 1]);
}

const at = (m: Float32Array, x: number, y: number): number[] =>
  [0, 1, 2].map((row) => (m[row] ?? 0) * x + (m[4 + row] ?? 0) * y + (m[12 + row] ?? 0));

function close(found: readonly number[], expected: readonly number[]): void {
  for (const [n, value] of expected.entries()) expect(found[n]).toBeCloseTo(value, 5);
}

describe("inFrontOf", () => {
  it("The screen is upright in front of the head, with its right side on the right.", () => {
    const room = inFrontOf({ matrix: head(1, 1.7, 2, 0) }, 1);
    close(at(room, 0, 0), [1, 1.7, 0.5]);
    close(at(room, 1, 1), [1.8, 2.5, 0.5]);
  });

  it("The screen follows the horizontal direction of the head and does not tilt when the head looks up.", () => {
    const room = inFrontOf({ matrix: head(0, 1.7, 0, 90, 40) }, 1);
    close(at(room, 0, 0), [-1.5, 1.7, 0]);
    close(at(room, 1, 0), [-1.5, 1.7, -0.8]);
  });

  it("The screen is at the front of the room for a head that looks straight up.", () => {
    for (const [x, z] of [
      [0, 0],
      [1e-6, 0],
      [0, 1e-6],
    ]) {
      const up = head(0, 1.7, 0, 0, 90);
      up[8] = x ?? 0;
      up[10] = z ?? 0;
      // The horizontal direction of a head that looks straight up is noise, so the screen is at the front of the room.
      close(at(inFrontOf({ matrix: up }, 1), 0, 0), [0, 1.7, -1.5]);
    }
  });

  it("The screen has the aspect ratio of the picture.", () => {
    close(at(inFrontOf({ matrix: IDENTITY }, 2), 1, 1), [1.6, 0.8, -1.5]);
    close(at(inFrontOf({ matrix: IDENTITY }, 0.5), 1, 1), [0.8, 1.6, -1.5]);
  });
});

describe("product", () => {
  it("The right matrix is applied first, as in WebGL.", () => {
    const move = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]);
    const scale = new Float32Array([2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0, 0, 0, 0, 1]);
    close([...product(move, scale)], [2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0, 5, 6, 7, 1]);
    close([...product(scale, move)].slice(12), [10, 18, 28, 1]);
  });
});

/** Return a fake of the WebGL functions in use, which records the draw calls. */
function fakeGl(log: string[], linksWell: boolean, places: Float32Array[]): WebGL2RenderingContext {
  const known: Record<string, unknown> = {
    uniformMatrix4fv: (_: unknown, __: boolean, place: Float32Array) => places.push(place),
    getProgramParameter: () => linksWell,
    getProgramInfoLog: () => "bad shader",
    createShader: () => ({}),
    createProgram: () => ({}),
    createTexture: () => ({}),
    getUniformLocation: () => ({}),
  };
  return new Proxy({} as WebGL2RenderingContext, {
    get: (_, name: string) => known[name] ?? ((..._of: unknown[]) => log.push(name)),
  });
}

function screenOf(log: string[], latest: () => LatestPicture | null, linksWell = true, shown = [true, true]) {
  let eye = 0;
  const states: object[] = [];
  const places: Float32Array[] = [];
  const gl = fakeGl(log, linksWell, places);
  const screen = new PictureScreen({
    latest,
    canvas: () => ({ getContext: () => gl }) as unknown as HTMLCanvasElement,
    layer: () => ({
      framebuffer: null,
      getViewport: () => (shown[eye++ % shown.length] ? { x: 0, y: 0, width: 9, height: 9 } : null),
    }),
  });
  const session = { updateRenderState: (state: object) => states.push(state) } as unknown as XrSession;
  return { screen, session, states, places };
}

const VIEW = { projectionMatrix: IDENTITY, transform: { inverse: { matrix: IDENTITY } } };
const VIEWER = { transform: { matrix: IDENTITY }, views: [VIEW, VIEW] } as unknown as XrViewerPose;
const IMAGE = { width: 4, height: 4 } as unknown as LatestPicture["image"];

describe("PictureScreen", () => {
  it("The picture is drawn for each eye at every refresh, and uploaded only when it is new.", async () => {
    const log: string[] = [];
    let frameId = 1;
    const { screen, session, states } = screenOf(log, () => ({ image: IMAGE, frameId, round: true }));
    await screen.open(session);
    expect(states.length).toBe(1);
    for (let n = 0; n < 30; n += 1) {
      if (n === 20) frameId = 2;
      screen.draw(VIEWER);
    }
    expect(log.filter((name) => name === "drawArrays").length).toBe(60);
    expect(log.filter((name) => name === "texImage2D").length).toBe(2);
    screen.close();
    screen.draw(VIEWER);
    expect(log.filter((name) => name === "drawArrays").length).toBe(60);
  });

  it("Each eye uses its own view matrix and then its projection matrix.", async () => {
    const { screen, session, places } = screenOf([], () => ({ image: IMAGE, frameId: 1, round: true }));
    await screen.open(session);
    const eye = new Float32Array(IDENTITY);
    eye[12] = 0.03;
    const projection = new Float32Array([2, 0, 0, 0, 0, 3, 0, 0, 0, 0, -1, -1, 0, 0, -0.2, 0]);
    const view = { projectionMatrix: projection, transform: { inverse: { matrix: eye } } };
    screen.draw({ transform: { matrix: IDENTITY }, views: [view] } as unknown as XrViewerPose);
    // The screen's middle is 1.5 m ahead and 3 cm to the right of this eye; the projection doubles the 3 cm.
    close([...(places[0] ?? [])].slice(12), [0.06, 0, 1.3, 1.5]);
  });

  it("The screen stays at its first position until it is placed again.", async () => {
    const { screen, session, places } = screenOf([], () => ({ image: IMAGE, frameId: 1, round: true }));
    await screen.open(session);
    screen.draw(VIEWER);
    const turned = { transform: { matrix: head(0, 0, 0, 90) }, views: [VIEW] } as unknown as XrViewerPose;
    screen.draw(turned);
    close([...(places.at(-1) ?? [])].slice(12), [0, 0, -1.5, 1]);
    screen.recenter();
    screen.draw(turned);
    close([...(places.at(-1) ?? [])].slice(12), [-1.5, 0, 0, 1]);
  });

  it("The picture is not drawn for an eye without a viewport.", async () => {
    const log: string[] = [];
    const { screen, session } = screenOf(log, () => ({ image: IMAGE, frameId: 1, round: true }), true, [true, false]);
    await screen.open(session);
    screen.draw(VIEWER);
    expect(log.filter((name) => name === "drawArrays").length).toBe(1);
  });

  it("A picture of another aspect ratio changes the width of the screen, but not its position.", async () => {
    let image = IMAGE;
    let frameId = 1;
    const { screen, session, places } = screenOf([], () => ({ image, frameId, round: true }));
    await screen.open(session);
    screen.draw(VIEWER);
    image = { width: 8, height: 4 } as unknown as LatestPicture["image"];
    frameId = 2;
    const distant = { transform: { matrix: head(5, 0, 0, 30) }, views: [VIEW] } as unknown as XrViewerPose;
    screen.draw(distant);
    const size = (place: Float32Array | undefined) => [Math.hypot(...(place ?? []).slice(0, 3)), place?.[5]];
    close(size(places[0]) as number[], [0.8, 0.8]);
    close(size(places.at(-1)) as number[], [1.6, 0.8]);
    close([...(places.at(-1) ?? [])].slice(12), [0, 0, -1.5, 1]);
  });

  it("Without a picture the screen is only cleared.", async () => {
    const log: string[] = [];
    const { screen, session } = screenOf(log, () => null);
    await screen.open(session);
    screen.draw(VIEWER);
    expect(log).toContain("clear");
    expect(log).not.toContain("drawArrays");
  });

  it("A failed shader link is reported with the device's message.", async () => {
    const { screen, session } = screenOf([], () => null, false);
    await expect(screen.open(session)).rejects.toThrow("bad shader");
  });
});
