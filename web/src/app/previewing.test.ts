import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { Preview, PreviewQuestion } from "../state/edit-preview";
import type { AskEditPreviewMessage, EditPreviewMessage } from "../wire/messages";
import { Previewing, REST_MS, STALE_MS } from "./previewing";
import type { Station } from "./station";

const at = (x: number): PreviewQuestion => ({
  tool: "add-branch",
  branch_id: null,
  lps: [x, 0, 0],
  frame_id: null,
  column: null,
  row: null,
});

function answer(id: number, x: number): EditPreviewMessage {
  return {
    type: "edit_preview",
    request_id: id,
    tool: "add-branch",
    lps: [x, 0, 0],
    lines: [],
    length_mm: 1,
    doubtful_mm: 0,
    has_evidence: true,
    origin: null,
    renamed: null,
    problem: null,
  };
}

function station() {
  const sent: AskEditPreviewMessage[] = [];
  const state: { preview: Preview | null } = { preview: null };
  const made = {
    state,
    send: (message: AskEditPreviewMessage) => sent.push(message) > 0,
    store: { dispatch: (event: { preview: Preview | null }) => Object.assign(state, { preview: event.preview }) },
  };
  const previewing = new Previewing(made as unknown as Station);
  return { previewing, sent, state, shows: () => state.preview?.answer?.lps?.[0] ?? null };
}

describe("preview of an edit under the cursor", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it("The preview has no answer and is stale until the first answer arrives.", () => {
    const { previewing, state, shows } = station();
    previewing.request(at(1));
    expect(state.preview).toEqual({ answer: null, stale: true });
    previewing.receive(answer(1, 1));
    expect(shows()).toBe(1);
    expect(state.preview?.stale).toBe(false);
  });

  it("After a cursor movement the old answer is stale at once and is hidden after STALE_MS.", () => {
    const { previewing, state, shows } = station();
    previewing.request(at(1));
    previewing.receive(answer(1, 1));
    previewing.request(at(2));
    expect(state.preview?.stale).toBe(true);
    vi.advanceTimersByTime(STALE_MS + 1);
    expect(state.preview).toEqual({ answer: null, stale: true });
    previewing.receive(answer(2, 2));
    expect(shows()).toBe(2);
    vi.advanceTimersByTime(10 * STALE_MS);
    expect(state.preview?.stale).toBe(false);
  });

  it("Only the latest cursor position is requested, and the answer to an older request is shown as stale.", () => {
    const { previewing, sent, state } = station();
    for (const x of [1, 2, 3]) previewing.request(at(x));
    previewing.receive(answer(1, 1));
    expect(state.preview?.stale).toBe(true);
    expect(sent.map((message) => message.lps?.[0])).toEqual([1, 3]);
    previewing.receive(answer(2, 3));
    expect(state.preview).toMatchObject({ stale: false, answer: { lps: [3, 0, 0] } });
  });

  it("A resting cursor requests once the branches that the edit would rename, and a movement cancels this.", () => {
    const { previewing, sent, state } = station();
    previewing.request(at(1));
    previewing.receive(answer(1, 1));
    vi.advanceTimersByTime(REST_MS - 1);
    previewing.request(at(2));
    previewing.receive(answer(2, 2));
    expect(sent.map((message) => message.with_names)).toEqual([false, false]);
    vi.advanceTimersByTime(REST_MS);
    expect(sent.at(-1)).toMatchObject({ with_names: true, lps: [2, 0, 0] });
    expect(state.preview?.stale).toBe(false);
    previewing.receive({ ...answer(3, 2), renamed: ["RB1 becomes RB1a"] });
    expect(state.preview?.answer?.renamed).toEqual(["RB1 becomes RB1a"]);
    vi.advanceTimersByTime(10 * REST_MS);
    expect(sent.length).toBe(3);
  });

  it("The same place causes no second request, but a change of the tree does.", () => {
    const { previewing, sent, state } = station();
    previewing.request(at(1));
    previewing.receive(answer(1, 1));
    previewing.request(at(1));
    expect(sent).toHaveLength(1);
    expect(state.preview?.stale).toBe(false);
    previewing.again();
    expect(state.preview?.stale).toBe(true);
    expect(sent).toHaveLength(2);
  });

  it("No preview is shown after the tool was deactivated, even if an answer arrives later.", () => {
    const { previewing, state } = station();
    previewing.request(at(1));
    previewing.forget();
    previewing.receive(answer(1, 1));
    vi.advanceTimersByTime(10 * STALE_MS);
    expect(state.preview).toBeNull();
    previewing.again();
    expect(state.preview).toBeNull();
  });
});
