import { describe, expect, it } from "vitest";
import type { PoseMessage } from "../../wire/messages";
import { ContactSense } from "./contact";

const pose = (inside: boolean, contacts: number | null): PoseMessage =>
  ({ inside, scope: contacts === null ? null : { num_contacts: contacts } }) as PoseMessage;
const felt = (poses: readonly (PoseMessage | null)[]): boolean[] => {
  const sense = new ContactSense();
  return poses.map((each) => sense.met(each));
};

describe("what the hand feels", () => {
  it("is the tip leaving the lumen where nothing holds it, once", () => {
    expect(felt([pose(true, null), pose(false, null), pose(false, null), pose(true, null), pose(false, null)])).toEqual(
      [false, true, false, false, true],
    );
  });

  it("is each new contact of a held scope, which never leaves the lumen", () => {
    expect(felt([pose(true, 0), pose(true, 1), pose(true, 1), pose(true, 3), pose(true, 3)])).toEqual([
      false,
      true,
      false,
      true,
      false,
    ]);
  });

  it("is nothing when a scope is laid anew, or another case is opened", () => {
    expect(felt([pose(true, 5), pose(true, 0), pose(true, null), pose(true, 7), null, pose(true, 9)])).toEqual([
      false,
      false,
      false,
      false,
      false,
      false,
    ]);
  });
});
