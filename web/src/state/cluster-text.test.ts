import { describe, expect, it } from "vitest";
import type { ClusterMessage, MemberStatus } from "../wire/messages";
import { clusterText, memberText, needsLook } from "./cluster-text";

const member = (state: MemberStatus["state"]): MemberStatus => ({
  name: "10.0.0.6",
  host: "laptop",
  threads: 4,
  simd: "avx2",
  state,
  share: 0.5,
  latency_ms: 6,
  num_late: 0,
  num_strips: 9,
});

const cluster = (members: MemberStatus[], changes: Partial<ClusterMessage> = {}): ClusterMessage => ({
  type: "cluster",
  address: "10.0.0.5:6379",
  members,
  alone: false,
  mixed: false,
  fps: 29,
  frame_ms: 21,
  ...changes,
});

describe("texts about the cluster", () => {
  it("clusterText states the number of computers that render.", () => {
    expect(clusterText(cluster([member("ready"), member("ready")]))).toBe("cluster: 2 machines");
    expect(clusterText(cluster([member("ready"), member("late")]))).toBe("cluster: 1 of 2 machines");
    expect(clusterText(cluster([member("ready")], { mixed: true }))).toBe("cluster: 1 machine, mixed");
    expect(clusterText(cluster([], { alone: true }))).toBe("cluster: this machine only");
  });

  it("needsLook is true for a late or lost computer, and false while one is loading the scan.", () => {
    expect(needsLook(cluster([member("ready"), member("loading")]))).toBe(false);
    expect(needsLook(cluster([member("ready"), member("late")]))).toBe(true);
    expect(needsLook(cluster([member("ready"), member("away")]))).toBe(true);
    expect(needsLook(cluster([], { alone: true }))).toBe(true);
    expect(memberText(member("late"))).toContain("other machines");
  });
});
