import { describe, expect, it } from "vitest";
import type { PoseMessage } from "../../wire/messages";
import { ContactSense } from "./contact";

const pose = (inside: boolean, contacts: number | null): PoseMessage =>
  ({ inside, scope: contacts === null ? null : { num_contacts: contacts } }) as PoseMessage;
const felt = (poses: readonly (PoseMessage | null)[]): boolean[] => {
  const sense = new ContactSense();
  return poses.map((each) => sense.met(each));
};

describe("ContactSense", () => {
  it("Without the scope simulation one contact is reported when the tip leaves the lumen.", () => {
    expect(felt([pose(true, null), pose(false, null), pose(false, null), pose(true, null), pose(false, null)])).toEqual(
      [false, true, false, false, true],
    );
  });

  it("With the scope simulation each increase of the contact count is reported once.", () => {
    expect(felt([pose(true, 0), pose(true, 1), pose(true, 1), pose(true, 3), pose(true, 3)])).toEqual([
      false,
      true,
      false,
      true,
      false,
    ]);
  });

  it("No contact is reported when a simulation starts again, when it ends, or when the case changes.", () => {
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
