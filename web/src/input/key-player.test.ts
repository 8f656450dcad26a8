import { describe, expect, it } from "vitest";
import { NOT_PLAYING, type Playing } from "../state/playing";
import type { ClientMessage, KeyFramesMessage, PoseMessage } from "../wire/messages";
import { KeyPlayer, keyFramesAround } from "./key-player";

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
});

function player(keys: KeyFramesMessage | null = KEYS) {
  const sent: ClientMessage[] = [];
  const around = { keys, playing: NOT_PLAYING as Playing, open: true };
  const made = new KeyPlayer(
    keyFramesAround(
      () => around.keys,
      (message) => {
        if (around.open) sent.push(message);
        return around.open;
      },
      (playing) => {
        around.playing = playing;
      },
    ),
  );
  return { made, sent, around };
}

const asked = (sent: ClientMessage[]) =>
  sent.map((one) => (one.type === "fly_key_frames" ? [one.time_s, one.goes_on] : one));

describe("the player of key frames", () => {
  it("begins by asking for the tip, goes on at each refresh, and ends at the end", () => {
    const { made, sent, around } = player();
    expect(made.play()).toBe(true);
    for (let n = 0; n < 50; n += 1) made.tick(0.1);
    const times = asked(sent) as [number, boolean][];
    expect(times[0]).toEqual([0, false]);
    expect(times.slice(1).every(([, goesOn]) => goesOn)).toBe(true);
    expect(times.map(([t]) => t)).toEqual([...times.map(([t]) => t)].sort((a, b) => a - b));
    expect(times.at(-1)).toEqual([4, true]);
    expect(times.length).toBeLessThan(44);
    expect(around.playing).toEqual({ on: false, atS: 4, rate: 1 });
    made.play();
    expect(asked(sent).at(-1)).toEqual([0, false]);
  });

  it("flies half as fast, or twice", () => {
    const { made, around } = player();
    made.setRate(0.5);
    made.play();
    made.tick(0.1);
    expect(around.playing.atS).toBeCloseTo(0.05, 9);
    made.setRate(2);
    made.tick(0.1);
    expect(around.playing.atS).toBeCloseTo(0.25, 9);
  });

  it("does not leap after a pause of the page", () => {
    const { made, around } = player();
    made.play();
    made.tick(60);
    expect(around.playing).toMatchObject({ on: true, atS: 0.1 });
  });

  it("stands where it is paused and goes on from there; stopping leads back to the start", () => {
    const { made, sent, around } = player();
    made.play();
    made.tick(0.1);
    made.toggle();
    const before = sent.length;
    made.tick(0.1);
    expect(sent).toHaveLength(before);
    made.toggle();
    expect(asked(sent).at(-1)).toEqual([0.1, false]);
    made.stop();
    expect(asked(sent).at(-1)).toEqual([0, false]);
    expect(around.playing).toMatchObject({ on: false, atS: 0 });
  });

  it("ends when a pose says that somebody took over, and not by one from before it began", () => {
    const { made, around } = player();
    made.poseArrived(pose(null));
    made.play();
    made.poseArrived(pose(null));
    expect(around.playing.on).toBe(true);
    made.tick(0.1);
    made.poseArrived(pose(0));
    made.poseArrived(pose(0.1));
    expect(around.playing.on).toBe(true);
    made.poseArrived(pose(null));
    expect(around.playing.on).toBe(false);
  });

  it("stands at the key frame that the tip was sent to, and does not follow its own echo", () => {
    const { made, around } = player();
    made.poseArrived(pose(2.5));
    expect(around.playing).toMatchObject({ on: false, atS: 2.5 });
    made.play();
    made.tick(0.1);
    made.poseArrived(pose(2.5));
    expect(around.playing.atS).toBeCloseTo(2.6, 9);
  });

  it("scrubs within the flight, also while it plays", () => {
    const { made, sent, around } = player();
    made.seek(99);
    expect(asked(sent)).toEqual([[4, false]]);
    made.seek(-1);
    made.play();
    made.seek(3);
    made.tick(0.1);
    expect(around.playing).toMatchObject({ on: true, atS: 3.1 });
  });

  it("is at a key frame, or at the end, where a bar with steps comes near to it", () => {
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
    expect(asked(sent).map((one) => (Array.isArray(one) ? one[0] : one))).toEqual([1.2345, 4, 2]);
  });

  it("has nothing to play without a flight or a connection, and stops when the list changes", () => {
    expect(player(null).made.play()).toBe(false);
    expect(player({ ...KEYS, duration_s: 0 }).made.play()).toBe(false);
    const off = player();
    off.around.open = false;
    expect(off.made.play()).toBe(false);
    expect(off.around.playing.on).toBe(false);
    const { made, around } = player();
    made.seek(3.5);
    made.play();
    made.reset(2);
    expect(around.playing).toMatchObject({ on: false, atS: 2 });
  });
});

describe("the player of a recorded flight", () => {
  it("begins its clock with the first answer, since the flight may be read first", () => {
    const asked: [number, boolean][] = [];
    let playing: Playing = NOT_PLAYING;
    const made = new KeyPlayer({
      durationS: () => 4,
      stops: () => [],
      fly: (timeS, goesOn) => asked.push([timeS, goesOn]) > 0,
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
    expect(asked).toEqual([[0, false]]);
    made.poseArrived(flown(0));
    made.tick(0.1);
    expect(asked).toEqual([
      [0, false],
      [0.1, true],
    ]);
    // The user moves the tip by hand.
    made.poseArrived(flown(null));
    expect(playing).toMatchObject({ on: false, atS: 0.1 });
    made.play();
    made.refused();
    expect(playing.on).toBe(false);
    made.begin();
    expect(playing).toMatchObject({ on: false, atS: 0 });
  });
});
