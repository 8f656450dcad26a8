/**
 * Interface of the workstation for its parts. The parts depend on this interface and not on the workstation, which
 * creates the parts.
 */

import type { Action } from "../input/keymap";
import type { Steering } from "../input/steering";
import type { AppState, Ui } from "../state/app-state";
import type { Store } from "../state/store";
import type { Vec3 } from "../state/vec";
import type { WallPoint } from "../state/wall-point";
import type { Wall } from "../views/wall";
import type { ClientMessage } from "../wire/messages";

/** Methods and values of the workstation that its parts use. */
export interface Station {
  readonly state: AppState;
  readonly store: Store;
  /** Send a message to the server; return false without a connection. */
  send(message: ClientMessage): boolean;
  /** Send the latest message of its kind at the next display refresh. */
  sendSoon(message: ClientMessage): void;
  ui(change: Partial<Ui>): void;
  notice(message: string): void;
  readonly wall: Wall;
  readonly flight: Steering;
  act(action: Action): void;
  chooseBranch(branchId: number): void;
  /** Add a target at a point, with the selected cost function of the path search. */
  addTarget(lps: Vec3): void;
  /** Deactivate the active tool. */
  disarm(): void;
  /** Restore the state before the first click of a double click. */
  restoreBeforeClick(before: { picks: readonly WallPoint[]; crosshair: Vec3 | null; selected: number | null }): void;
  /** Return the crosshair, or the position of the tip if the slices follow it, LPS mm; null without a pose. */
  centre(): Vec3 | null;
}
