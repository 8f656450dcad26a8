import { describe, expect, it } from "vitest";
import { AUTO_SPEED_MM_S } from "../state/speed";
import type { ClientMessage, RouteInfo } from "../wire/messages";
import { SLOW, SPEED_MM_S, Steering } from "./steering";

const ROUTE: RouteInfo = {
  route_id: "r",
  title: "",
  target_id: null,
  branch_id: null,
  points_lps: [],
  cumulative_mm: [],
  generation: [],
  radius_mm: [],
  wall_mm: [],
  forks_mm: [36, 54],
  lookouts_mm: [30, 50],
  spans: [],
  lumen_known: true,
  narrowest_mm: null,
  narrowest_error_mm: null,
  narrowest_at_mm: null,
  scope_fits: [],
  origin: { kind: "root", along_mm: 0 },
  centreline_mm: [],
  needle: null,
  length_mm: 60,
  drawn_mm: 0,
  bridge_mm: 0,
};

function flight(route: RouteInfo | null = ROUTE) {
  const sent: ClientMessage[] = [];
  const auto: boolean[] = [];
  const environment = { at: 10 as number | null, speed: AUTO_SPEED_MM_S };
  const made = new Steering({
    route: () => route,
    pathMm: () => environment.at,
    speedMmS: () => environment.speed,
    send: (message) => {
      sent.push(message);
      if (message.type === "go_to") environment.at = message.path_mm;
    },
    advancing: (on) => auto.push(on),
  });
  return { made, sent, auto, environment };
}

describe("Steering", () => {
  it("A stick of the flight pad moves the tip in proportion to its deflection until it rests.", () => {
    const { made, sent } = flight();
    made.stick("advance", 0.5);
    made.stick("yaw", -3);
    expect(made.isMoving).toBe(true);
    made.tick(0.1);
    expect(sent).toEqual([{ type: "steer", advance_mm: 0.05 * SPEED_MM_S, yaw_rad: -0.1, pitch_rad: 0, roll_rad: 0 }]);
    made.stick("advance", 0);
    made.stick("yaw", 0);
    expect(made.isMoving).toBe(false);
  });

  it("isMoving is true while a key is held or movement waits to be sent, and false at rest.", () => {
    const { made } = flight();
    expect(made.isMoving).toBe(false);
    made.hold("yaw", 1, true);
    expect(made.isMoving).toBe(true);
    made.hold("yaw", 1, false);
    expect(made.isMoving).toBe(false);
    made.nudge({ advance_mm: 2 });
    expect(made.isMoving).toBe(true);
    made.tick(1 / 60);
    expect(made.isMoving).toBe(false);
  });

  it("One steer message is sent per refresh while a key is held, and none without a key.", () => {
    const { made, sent } = flight();
    made.tick(0.016);
    expect(sent).toEqual([]);
    made.hold("advance", 1, true);
    made.tick(0.02);
    made.hold("advance", 1, false);
    made.tick(0.02);
    expect(sent).toEqual([{ type: "steer", advance_mm: SPEED_MM_S * 0.02, yaw_rad: 0, pitch_rad: 0, roll_rad: 0 }]);
  });

  it("The distance in a given time does not depend on the number of refreshes.", () => {
    const far = (steps: number) => {
      const { made, sent } = flight();
      made.hold("advance", 1, true);
      for (let step = 0; step < steps; step += 1) made.tick(0.3 / steps);
      return sent.reduce((sum, message) => sum + (message.type === "steer" ? message.advance_mm : 0), 0);
    };
    expect(far(30)).toBeCloseTo(far(3), 9);
  });

  it("Shift reduces the speed by the factor SLOW, and two opposite keys cancel each other.", () => {
    const { made, sent } = flight();
    made.slow(true);
    made.hold("advance", 1, true);
    made.tick(0.02);
    expect(sent[0]).toMatchObject({ advance_mm: SPEED_MM_S * SLOW * 0.02 });
    made.hold("advance", -1, true);
    made.tick(0.02);
    expect(sent).toHaveLength(1);
  });

  it("Mouse movements between two refreshes are sent as one sum.", () => {
    const { made, sent } = flight();
    made.nudge({ yaw_rad: 0.1 });
    made.nudge({ yaw_rad: 0.1, pitch_rad: -0.2 });
    made.tick(0.016);
    expect(sent).toEqual([{ type: "steer", advance_mm: 0, yaw_rad: 0.2, pitch_rad: -0.2, roll_rad: 0 }]);
  });

  it("After a pause of the page the tip moves by at most MAX_TICK_S of movement.", () => {
    const { made, sent } = flight();
    made.hold("advance", 1, true);
    made.tick(30);
    expect(sent[0]).toMatchObject({ advance_mm: SPEED_MM_S * 0.1 });
  });

  it("The automatic flight stops exactly at the viewpoint before the next fork and can be started again.", () => {
    const { made, sent, auto } = flight();
    expect(made.startAuto()).toBe(true);
    const needed = Math.ceil(20 / AUTO_SPEED_MM_S / 0.05) + 1;
    for (let step = 0; step < needed; step += 1) made.tick(0.05);
    const places = sent.map((message) => (message.type === "go_to" ? message.path_mm : Number.NaN));
    expect(places).toEqual([...places].sort((a, b) => a - b));
    expect(places.at(-1)).toBe(30);
    expect(auto).toEqual([true, false]);
    expect(made.startAuto()).toBe(true);
  });

  it("The automatic flight uses the selected speed, multiplied by SLOW while Shift is held.", () => {
    const { made, sent, environment } = flight();
    environment.speed = 7;
    made.startAuto();
    made.tick(0.05);
    made.slow(true);
    made.tick(0.05);
    const places = sent.map((message) => (message.type === "go_to" ? message.path_mm : Number.NaN));
    expect(places[0]).toBeCloseTo(10 + 7 * 0.05, 9);
    expect(places[1]).toBeCloseTo(10 + 7 * 0.05 * (1 + SLOW), 9);
  });

  it("The automatic flight stops when the user advances the tip, but not when the user turns the view.", () => {
    const { made, auto } = flight();
    made.startAuto();
    made.nudge({ yaw_rad: 0.1 });
    expect(made.isAuto).toBe(true);
    made.nudge({ advance_mm: -1 });
    expect(made.isAuto).toBe(false);
    made.startAuto();
    made.hold("advance", -1, true);
    expect(auto).toEqual([true, false, true, false]);
  });

  it("The automatic flight does not start without a route, off the route, or at the end of the route.", () => {
    expect(flight(null).made.startAuto()).toBe(false);
    const off = flight();
    off.environment.at = null;
    expect(off.made.startAuto()).toBe(false);
    off.environment.at = 60;
    expect(off.made.startAuto()).toBe(false);
  });
});
