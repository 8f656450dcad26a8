import { describe, expect, it } from "vitest";
import type { RouteInfo, StateMessage } from "../wire/messages";
import type { BranchTree } from "./airways";
import { INITIAL_STATE } from "./app-state";
import { forksProblem, isSearchedInAirways } from "./fork-sheet";

const session = (cost: string) => ({ targets: [{ target_id: "target-1", cost }] }) as unknown as StateMessage;
const route = { target_id: "target-1", needle: null, forks_mm: [12] } as unknown as RouteInfo;
const state = { ...INITIAL_STATE, tree: {} as BranchTree, route };

describe("picture of the forks", () => {
  it("A path by walls has no forks, and a path in the lumen has.", () => {
    expect(forksProblem({ ...state, session: session("walls") })).toMatch(/not searched in the airways/);
    expect(forksProblem({ ...state, session: session("lumen") })).toBeNull();
  });

  it("A planned route with a needle, and a route to a branch, follow the airways.", () => {
    const needle = { ends_lps: [], to_target_mm: 5 } as unknown as RouteInfo["needle"];
    expect(isSearchedInAirways({ session: session("walls"), route: { ...route, needle } })).toBe(true);
    expect(isSearchedInAirways({ session: session("walls"), route: { ...route, target_id: null } })).toBe(true);
    expect(isSearchedInAirways({ session: session("walls"), route })).toBe(false);
  });

  it("A route without forks and a running job state the reason.", () => {
    expect(forksProblem({ ...state, route: null })).toMatch(/no route/);
    expect(forksProblem({ ...state, route: { ...route, forks_mm: [] } })).toMatch(/no fork/);
    expect(forksProblem({ ...state, ui: { ...state.ui, makingForks: true } })).toMatch(/being rendered/);
  });
});
