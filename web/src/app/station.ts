/** What the parts of the workstation may ask of it. The workstation makes them, so they know no more of it than this. */

import type { Flight } from "../input/flight";
import type { Action } from "../input/keymap";
import type { AppState, Ui } from "../state/app-state";
import type { Store } from "../state/store";
import type { Vec3 } from "../state/vec";
import type { WallPoint } from "../state/wall-point";
import type { Wall } from "../views/wall";
import type { ClientMessage } from "../wire/messages";

export interface Station {
  readonly state: AppState;
  readonly store: Store;
  /** False where it could not be sent. */
  send(message: ClientMessage): boolean;
  ui(change: Partial<Ui>): void;
  notice(message: string): void;
  readonly wall: Wall;
  readonly flight: Flight;
  act(action: Action): void;
  chooseBranch(branchId: number): void;
  /** A target, its path searched as chosen. */
  addTarget(lps: Vec3): void;
  /** Nothing is in the hand any more. */
  disarm(): void;
  /** As it was before a click that turned out to be the first half of a double click. */
  takeBack(before: { picks: readonly WallPoint[]; crosshair: Vec3 | null; selected: number | null }): void;
  /** The crosshair, or where the tip is. */
  centre(): Vec3 | null;
}
