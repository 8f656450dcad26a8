import { describe, expect, test } from "vitest";
import { INITIAL_STATE } from "./app-state";
import { Store } from "./store";

const speed = (speedMmS: number) => ({ kind: "speed", speedMmS }) as const;
const advancing = (on: boolean) => ({ kind: "ui", change: { advancing: on } }) as const;

function storeWithListeners() {
  const due: (() => void)[] = [];
  const store = new Store(INITIAL_STATE, (task) => due.push(task));
  const calls = { all: 0, panels: 0 };
  store.subscribe(() => {
    calls.all += 1;
  });
  const leave = store.subscribePanel(() => {
    calls.panels += 1;
  });
  const refresh = () => {
    for (const task of due.splice(0)) task();
  };
  return { store, calls, refresh, leave };
}

describe("Store", () => {
  test("A panel is notified of streamed events once per display refresh, and other listeners of each event.", () => {
    const { store, calls, refresh } = storeWithListeners();
    for (const one of [1, 2, 3]) store.dispatch(speed(one));
    expect(store.get().speedMmS).toBe(3);
    expect(calls).toEqual({ all: 3, panels: 0 });
    refresh();
    expect(calls).toEqual({ all: 3, panels: 1 });
    refresh();
    expect(calls.panels).toBe(1);
    store.dispatch(speed(4));
    refresh();
    expect(calls.panels).toBe(2);
  });

  test("A panel is notified of a user action at once, together with the streamed events before it.", () => {
    const { store, calls, refresh } = storeWithListeners();
    store.dispatch(speed(1));
    store.dispatch(advancing(true));
    expect(calls.panels).toBe(1);
    refresh();
    expect(calls.panels).toBe(1);
  });

  test("A panel that has unsubscribed is not notified.", () => {
    const { store, calls, refresh, leave } = storeWithListeners();
    store.dispatch(speed(1));
    refresh();
    leave();
    store.dispatch(advancing(true));
    expect(calls.panels).toBe(1);
  });
});
