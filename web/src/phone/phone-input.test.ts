import { beforeEach, describe, expect, it } from "vitest";
import type { PhoneMessage } from "../wire/messages";
import { checkPhoneMessage } from "../wire/parse";
import { PhoneInput } from "./phone-input";

let sent: PhoneMessage[];
let open: boolean;
let hand: PhoneInput;

beforeEach(() => {
  sent = [];
  open = true;
  hand = new PhoneInput((message) => {
    if (!open) return false;
    checkPhoneMessage(JSON.stringify(message));
    sent.push(message);
    return true;
  });
});

describe("PhoneInput", () => {
  it("A turn of the phone sends nothing while no button is held.", () => {
    for (let n = 0; n < 100; n += 1) {
      hand.turned([Math.cos(n), Math.sin(n), 0, 0]);
      hand.tick(n / 60);
    }
    expect(sent).toEqual([]);
  });

  it("While the turn button is held each new orientation is sent, at most 65 per second; its release is sent once.", () => {
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

  it("A held button without an orientation is sent about ten times per second.", () => {
    hand.hold("forward", true);
    for (let n = 0; n <= 60; n += 1) hand.tick(n / 60);
    expect(sent.length).toBeGreaterThanOrEqual(9);
    expect(sent.length).toBeLessThanOrEqual(12);
    expect(sent[0]).toMatchObject({ orientation_wxyz: null, held: false, advance: 1 });
  });

  it("The advance is 0 while forward and back are both held.", () => {
    hand.hold("forward", true);
    hand.tick(0);
    hand.hold("back", true);
    hand.tick(0.02);
    expect(sent.map((m) => (m.type === "phone_sample" ? m.advance : null))).toEqual([1, 0]);
  });

  it("An unchanged orientation is sent about ten times per second, and a changed one at once.", () => {
    hand.hold("turn", true);
    hand.turned([1, 0, 0, 0]);
    for (let n = 0; n < 60; n += 1) hand.tick(n / 60);
    expect(sent.length).toBeGreaterThanOrEqual(9);
    expect(sent.length).toBeLessThanOrEqual(11);
    hand.turned([0, 1, 0, 0]);
    hand.tick(1);
    expect(sent.at(-1)).toMatchObject({ orientation_wxyz: [0, 1, 0, 0] });
  });

  it("release() releases all buttons, and the release is sent.", () => {
    hand.hold("turn", true);
    hand.hold("back", true);
    hand.tick(0);
    hand.release();
    hand.tick(0.5);
    expect(sent.at(-1)).toMatchObject({ held: false, advance: 0 });
  });

  it("Input that was not sent without a connection is sent after the reconnection.", () => {
    hand.hold("turn", true);
    open = false;
    hand.tick(0);
    open = true;
    hand.tick(0.001);
    expect(sent.length).toBe(1);
  });

  it("The latest valid orientation is used after the sensor has reported no orientation.", () => {
    hand.turned([0, 1, 0, 0]);
    hand.turned(null);
    hand.hold("turn", true);
    hand.tick(0);
    expect(sent[0]).toMatchObject({ orientation_wxyz: [0, 1, 0, 0] });
  });
});
