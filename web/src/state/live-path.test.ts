import { describe, expect, it } from "vitest";
import type { AskLivePathMessage, LivePathMessage } from "../wire/messages";
import { firstSentences, LivePathQueue, type LiveQuestion, leavesTreeAt, livePathLines } from "./live-path";

const at = (x: number): LiveQuestion => ({ lps: [x, 0, 0], frame_id: null, column: null, row: null });

function answer(requestId: number, change: Partial<LivePathMessage> = {}): LivePathMessage {
  return {
    type: "live_path",
    request_id: requestId,
    lps: [0, 0, 0],
    points_lps: [
      [0, 0, 0],
      [0, 0, -10],
    ],
    length_mm: 10,
    from_carina_mm: 10,
    min_diameter_mm: 4.2,
    confidence: 0.86,
    snapped_mm: 0,
    new_mm: 0,
    joins_branch_id: 1,
    problem: null,
    ...change,
  };
}

function queueWithClock() {
  const sent: AskLivePathMessage[] = [];
  const clock = { ms: 0 };
  const line = { open: true };
  const queue = new LivePathQueue(
    (message) => {
      if (line.open) sent.push(message);
      return line.open;
    },
    () => clock.ms,
  );
  return { sent, clock, line, queue, places: () => sent.map((message) => message.lps?.[0]) };
}

describe("LivePathQueue", () => {
  it("The first request is sent at once, and of those before its answer only the latest is sent.", () => {
    const { queue, places } = queueWithClock();
    for (const x of [1, 2, 3, 4]) queue.request(at(x));
    expect(places()).toEqual([1]);
    expect(queue.receive(answer(1))?.answer.request_id).toBe(1);
    expect(places()).toEqual([1, 4]);
    queue.receive(answer(2));
    expect(places()).toEqual([1, 4]);
  });

  it("An answer contains its response time.", () => {
    const { queue, clock } = queueWithClock();
    queue.request(at(1));
    clock.ms = 17;
    expect(queue.receive(answer(1))?.tookMs).toBe(17);
  });

  it("The answer to a forgotten request, or to one that a newer answer has overtaken, is discarded.", () => {
    const { queue, clock } = queueWithClock();
    queue.request(at(1));
    queue.forget();
    expect(queue.receive(answer(1))).toBeNull();
    queue.request(at(2));
    clock.ms = 5000;
    queue.request(at(3));
    expect(queue.receive(answer(3))).not.toBeNull();
    expect(queue.receive(answer(2))).toBeNull();
  });

  it("A new request is sent after an answer has not arrived for 10 s, and after a reset.", () => {
    const { queue, clock, places, line } = queueWithClock();
    queue.request(at(1));
    clock.ms = 10_000;
    queue.request(at(2));
    expect(places()).toEqual([1, 2]);
    queue.reset();
    line.open = false;
    queue.request(at(3));
    line.open = true;
    queue.request(at(4));
    expect(places()).toEqual([1, 2, 4]);
  });
});

describe("livePathLines", () => {
  it("The lines state length, narrowest diameter and confidence, and what is new or was moved.", () => {
    expect(livePathLines(answer(1)).lines).toEqual([
      "10\u202fmm past the main carina",
      "fits up to 4.2\u202fmm",
      "86 % confidence",
    ]);
    const more = livePathLines(answer(1, { new_mm: 12.5, snapped_mm: 1.25, confidence: null })).lines;
    expect(more.slice(2)).toEqual(["12.5\u202fmm beyond the tree", "moved 1.3\u202fmm into the lumen"]);
  });

  it("Without a path the line is the server's reason as a sentence, with a warning.", () => {
    const none = livePathLines(answer(1, { length_mm: null, problem: "the lumen ends 8 mm from here" }));
    expect(none).toEqual({ lines: ["The lumen ends 8 mm from here"], warns: true });
  });
});

describe("firstSentences", () => {
  it("A long text is cut after a whole sentence, never within a number.", () => {
    const long = "This is soft tissue, not an airway. The nearest airway that was found is 12.5 mm away (up to 5 mm).";
    expect(firstSentences(`${long} Point at an airway; if one is missing here, paint its lumen.`)).toBe(
      "This is soft tissue, not an airway.",
    );
    expect(firstSentences("It is 12.5 mm away. Go on.")).toBe("It is 12.5 mm away. Go on.");
    expect(firstSentences("no full stop")).toBe("no full stop");
  });
});

describe("leavesTreeAt", () => {
  const points = [0, 10, 20, 30].map((z) => [0, 0, z] as const);
  it("The index is found from the end of the path by the length of its new part.", () => {
    expect(leavesTreeAt(points, 0)).toBe(3);
    expect(leavesTreeAt(points, null)).toBe(3);
    expect(leavesTreeAt(points, 10)).toBe(2);
    expect(leavesTreeAt(points, 12)).toBe(1);
    expect(leavesTreeAt(points, 500)).toBe(0);
  });
});
