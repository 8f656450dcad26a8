import { describe, expect, it } from "vitest";
import { NOT_PLAYING, type Playing } from "../state/playing";
import type { ClientMessage, KeyFramesMessage, PoseMessage } from "../wire/messages";
import { KeyPlayer, keyFrameHooks } from "./key-frame-player";

const KEYS: KeyFramesMessage = {
  type: "key_frames",
  frames: [],
  speed_mm_s: 20,
  through: "airways",
  duration_s: 4,
  problem: null,
};

const pose = (key_frames_s: number | null): PoseMessage => ({
  type: "pose",
  pose_id: 1,
  lps_from_camera: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  mode: "free",
  path_mm: null,
  branch_id: null,
  branch_name: null,
  generation: null,
  lumen_mm: null,
  inside: true,
  scope: null,
  key_frames_s,
  flight: null,
  by_device: false,
  back_to_route_mm: null,
});

function player(keys: KeyFramesMessage | null = KEYS) {
  const sent: ClientMessage[] = [];
  const environment = { keys, playing: NOT_PLAYING as Playing, open: true };
  const made = new KeyPlayer(
    keyFrameHooks(
      () => environment.keys,
      (message) => {
        if (environment.open) sent.push(message);
        return environment.open;
      },
      (playing) => {
        environment.playing = playing;
      },
    ),
  );
  return { made, sent, environment };
}

const requested = (sent: ClientMessage[]) =>
  sent.map((one) => (one.type === "fly_key_frames" ? [one.time_s, one.goes_on] : one));

describe("KeyPlayer with key frames", () => {
  it("first sends the current time, continues at each refresh, and stops at the end of the flight", () => {
    const { made, sent, environment } = player();
    expect(made.play()).toBe(true);
    for (let n = 0; n < 50; n += 1) made.tick(0.1);
    const times = requested(sent) as [number, boolean][];
    expect(times[0]).toEqual([0, false]);
    expect(times.slice(1).every(([, goesOn]) => goesOn)).toBe(true);
    expect(times.map(([t]) => t)).toEqual([...times.map(([t]) => t)].sort((a, b) => a - b));
    expect(times.at(-1)).toEqual([4, true]);
    expect(times.length).toBeLessThan(44);
    expect(environment.playing).toEqual({ on: false, atS: 4, rate: 1 });
    made.play();
    expect(requested(sent).at(-1)).toEqual([0, false]);
  });

  it("The position advances by the elapsed time multiplied by the playback rate.", () => {
    const { made, environment } = player();
    made.setRate(0.5);
    made.play();
    made.tick(0.1);
    expect(environment.playing.atS).toBeCloseTo(0.05, 9);
    made.setRate(2);
    made.tick(0.1);
    expect(environment.playing.atS).toBeCloseTo(0.25, 9);
  });

  it("After a pause of the page the position advances by at most 0.1 s.", () => {
    const { made, environment } = player();
    made.play();
    made.tick(60);
    expect(environment.playing).toMatchObject({ on: true, atS: 0.1 });
  });

  it("A paused flight continues at the same position, and stopping returns to the beginning.", () => {
    const { made, sent, environment } = player();
    made.play();
    made.tick(0.1);
    made.toggle();
    const before = sent.length;
    made.tick(0.1);
    expect(sent).toHaveLength(before);
    made.toggle();
    expect(requested(sent).at(-1)).toEqual([0.1, false]);
    made.stop();
    expect(requested(sent).at(-1)).toEqual([0, false]);
    expect(environment.playing).toMatchObject({ on: false, atS: 0 });
  });

  it("A pose of another origin stops the playback, but not a pose that was sent before the playback began.", () => {
    const { made, environment } = player();
    made.poseArrived(pose(null));
    made.play();
    made.poseArrived(pose(null));
    expect(environment.playing.on).toBe(true);
    made.tick(0.1);
    made.poseArrived(pose(0));
    made.poseArrived(pose(0.1));
    expect(environment.playing.on).toBe(true);
    made.poseArrived(pose(null));
    expect(environment.playing.on).toBe(false);
  });

  it("shows the time of a pose at rest, and ignores older poses of the flight during playback", () => {
    const { made, environment } = player();
    made.poseArrived(pose(2.5));
    expect(environment.playing).toMatchObject({ on: false, atS: 2.5 });
    made.play();
    made.tick(0.1);
    made.poseArrived(pose(2.5));
    expect(environment.playing.atS).toBeCloseTo(2.6, 9);
  });

  it("The slider is limited to the flight's duration and can be moved during playback.", () => {
    const { made, sent, environment } = player();
    made.seek(99);
    expect(requested(sent)).toEqual([[4, false]]);
    made.seek(-1);
    made.play();
    made.seek(3);
    made.tick(0.1);
    expect(environment.playing).toMatchObject({ on: true, atS: 3.1 });
  });

  it("A slider position within 0.02 s of a key frame or the end selects it exactly.", () => {
    const frames = [0, 1.2345, 4].map((time_s, n) => ({
      key_id: `key-${n}`,
      name: "",
      own_name: false,
      branch_id: null,
      speed_mm_s: null,
      time_s,
      leg_mm: null,
      through_airways: false,
    }));
    const { made, sent } = player({ ...KEYS, frames });
    for (const at of [1.23, 3.99, 2]) made.seek(at);
    expect(requested(sent).map((one) => (Array.isArray(one) ? one[0] : one))).toEqual([1.2345, 4, 2]);
  });

  it("Playback does not start without a flight or a connection, and stops when the list changes.", () => {
    expect(player(null).made.play()).toBe(false);
    expect(player({ ...KEYS, duration_s: 0 }).made.play()).toBe(false);
    const off = player();
    off.environment.open = false;
    expect(off.made.play()).toBe(false);
    expect(off.environment.playing.on).toBe(false);
    const { made, environment } = player();
    made.seek(3.5);
    made.play();
    made.limitDuration(2);
    expect(environment.playing).toMatchObject({ on: false, atS: 2 });
  });
});

describe("KeyPlayer with a recorded flight", () => {
  it("The playback clock starts when the first pose of the flight arrives, because the server may load the flight.", () => {
    const requested: [number, boolean][] = [];
    let playing: Playing = NOT_PLAYING;
    const made = new KeyPlayer({
      durationS: () => 4,
      stops: () => [],
      fly: (timeS, goesOn) => requested.push([timeS, goesOn]) > 0,
      timeOf: (one) => one.flight?.time_s ?? null,
      waits: true,
      changed: (now) => {
        playing = now;
      },
    });
    const flown = (time_s: number | null) => ({
      ...pose(null),
      flight: time_s === null ? null : { number: 2, time_s },
    });
    made.play();
    made.tick(0.1);
    made.poseArrived(flown(null));
    made.tick(0.1);
    expect(requested).toEqual([[0, false]]);
    made.poseArrived(flown(0));
    made.tick(0.1);
    expect(requested).toEqual([
      [0, false],
      [0.1, true],
    ]);
    // The user moves the tip by hand.
    made.poseArrived(flown(null));
    expect(playing).toMatchObject({ on: false, atS: 0.1 });
    made.play();
    made.stopIfUnanswered();
    expect(playing.on).toBe(false);
    made.resetToStart();
    expect(playing).toMatchObject({ on: false, atS: 0 });
  });
});
