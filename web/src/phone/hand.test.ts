import { beforeEach, describe, expect, it } from "vitest";
import type { PhoneMessage } from "../wire/messages";
import { checkPhoneMessage } from "../wire/parse";
import { Hand } from "./hand";

let sent: PhoneMessage[];
let open: boolean;
let hand: Hand;

beforeEach(() => {
  sent = [];
  open = true;
  hand = new Hand((message) => {
    if (!open) return false;
    checkPhoneMessage(JSON.stringify(message));
    sent.push(message);
    return true;
  });
});

describe("the hand on a phone", () => {
  it("says nothing while nothing is held, however the phone is turned", () => {
    for (let n = 0; n < 100; n += 1) {
      hand.turned([Math.cos(n), Math.sin(n), 0, 0]);
      hand.tick(n / 60);
    }
    expect(sent).toEqual([]);
  });

  it("says each new turn while it is held, 65 times a second at most, and once more when it is let go", () => {
    hand.hold("turn", true);
    for (let n = 0; n < 240; n += 1) {
      hand.turned([1, n / 1000, 0, 0]);
      hand.tick(n / 240);
    }
    expect(sent.length).toBeGreaterThan(50);
    expect(sent.length).toBeLessThanOrEqual(66);
    hand.hold("turn", false);
    hand.tick(1.001);
    expect(sent.at(-1)).toMatchObject({ held: false, advance: 0 });
    const number = sent.length;
    hand.tick(2);
    hand.tick(3);
    expect(sent.length).toBe(number);
  });

  it("repeats what is held ten times a second where the phone lies still or has no sensor", () => {
    hand.hold("forward", true);
    for (let n = 0; n <= 60; n += 1) hand.tick(n / 60);
    expect(sent.length).toBeGreaterThanOrEqual(9);
    expect(sent.length).toBeLessThanOrEqual(12);
    expect(sent[0]).toMatchObject({ orientation_wxyz: null, held: false, advance: 1 });
  });

  it("goes nowhere while forward and back are both held", () => {
    hand.hold("forward", true);
    hand.tick(0);
    hand.hold("back", true);
    hand.tick(0.02);
    expect(sent.map((m) => (m.type === "phone_sample" ? m.advance : null))).toEqual([1, 0]);
  });

  it("that is still is said again ten times a second, and a turn at once", () => {
    hand.hold("turn", true);
    hand.turned([1, 0, 0, 0]);
    for (let n = 0; n < 60; n += 1) hand.tick(n / 60);
    expect(sent.length).toBeGreaterThanOrEqual(9);
    expect(sent.length).toBeLessThanOrEqual(11);
    hand.turned([0, 1, 0, 0]);
    hand.tick(1);
    expect(sent.at(-1)).toMatchObject({ orientation_wxyz: [0, 1, 0, 0] });
  });

  it("lets go of everything when the page is left", () => {
    hand.hold("turn", true);
    hand.hold("back", true);
    hand.tick(0);
    hand.letGo();
    hand.tick(0.5);
    expect(sent.at(-1)).toMatchObject({ held: false, advance: 0 });
  });

  it("says it again once the connection is back", () => {
    hand.hold("turn", true);
    open = false;
    hand.tick(0);
    open = true;
    hand.tick(0.001);
    expect(sent.length).toBe(1);
  });

  it("keeps its last turn when the sensor says nonsense in between", () => {
    hand.turned([0, 1, 0, 0]);
    hand.turned(null);
    hand.hold("turn", true);
    hand.tick(0);
    expect(sent[0]).toMatchObject({ orientation_wxyz: [0, 1, 0, 0] });
  });
});
