/** What is drawn over the pictures, taken from the state once per repaint. */

import { type AppState, crosshairLps, maskOf, pathMm } from "../state/app-state";
import type { PlaneName } from "../state/tri-plane";
import { asVec3, type Camera, cameraFromMatrix, type Vec3 } from "../state/vec";
import type { Grid } from "../state/volume";
import type { RouteInfo, StateMessage } from "../wire/messages";
import { type Shape, shapeOf } from "./outline";

export interface SceneTarget {
  lps: Vec3;
  name: string;
  reachable: boolean;
  chosen: boolean;
}

export interface Scene {
  /** The newest pose, ahead of the pictures. */
  tip: Camera | null;
  /** Where the slices meet. */
  crosshair: Vec3 | null;
  followsTip: boolean;
  route: RouteInfo | null;
  routePoints: readonly Vec3[];
  routeLineVisible: boolean;
  pathMm: number | null;
  targets: readonly SceneTarget[];
  root: Vec3 | null;
  airwayShape: Shape;
  /** The volume's box. */
  grid: Grid | null;
  carm: StateMessage["carm"] | null;
  slab: StateMessage["slab"] | null;
  /** The plane of the tri-plane view under the cursor. */
  overPlane: PlaneName | null;
  /** Clicked points of the wall, newest last. */
  wallPoints: readonly Vec3[];
}

let cachedFor: RouteInfo | null = null;
let cachedPoints: readonly Vec3[] = [];

export function sceneOf(state: AppState): Scene {
  if (state.route !== cachedFor) {
    cachedFor = state.route;
    cachedPoints = state.route?.points_lps.map((point) => asVec3(point)) ?? [];
  }
  const tip = state.pose === null ? null : cameraFromMatrix(state.pose.lps_from_camera);
  const cross = crosshairLps(state);
  return {
    tip,
    crosshair: cross ?? tip?.position ?? null,
    followsTip: cross === null,
    route: state.route,
    routePoints: cachedPoints,
    routeLineVisible: state.ui.routeLineVisible,
    pathMm: pathMm(state),
    targets:
      state.session?.targets.map((target) => ({
        lps: asVec3(target.used_lps ?? target.lps),
        name: target.name,
        reachable: target.problem === null,
        chosen: target.target_id === state.route?.target_id,
      })) ?? [],
    root: state.session?.root_lps == null ? null : asVec3(state.session.root_lps),
    airwayShape: shapeOf(maskOf(state)),
    grid: state.session?.case ?? null,
    carm: state.session?.carm ?? null,
    slab: state.session?.slab ?? null,
    overPlane: state.ui.overPlane,
    wallPoints: state.picks.map((point) => point.lps),
  };
}
