import { describe, expect, it } from "vitest";
import {
  type ClientMessage,
  FIRST_LOOK,
  FIRST_SIGHT,
  type PoseMessage,
  SETS,
  type ServerMessage,
  type Sight,
  type StateMessage,
} from "../wire/messages";
import { type AppEvent, type AppState, crosshairLps, INITIAL_STATE, pathMm, reduce } from "./app-state";
import { sliceText } from "./opening";
import { NOT_SENT } from "./optimistic";
import { NOTHING_SAVED } from "./saving.testing";

const EMPTY: StateMessage = {
  type: "state",
  case: null,
  stage: "empty",
  airways: "none",
  airways_words: null,
  mode: "free",
  look: FIRST_LOOK,
  sight: { ...FIRST_SIGHT, window: { width_hu: 1500, level_hu: -600 } },
  transfer: "endoscopic",
  transfer_document: null,
  transfer_presets: [],
  targets: [],
  route_id: null,
  can_undo: null,
  can_redo: null,
  root_lps: null,
  lumen_threshold: null,
  frame_rate_hz: 60,
  airways_from: null,
  badges: [],
  mask_question: null,
  breathing: { on: false, movement_mm: 12, period_s: 3.6 },
  saving: { ...NOTHING_SAVED, keeps: false },
};

const OPEN: StateMessage = {
  ...EMPTY,
  stage: "ready",
  case: {
    title: "Thorax",
    format: "dicom",
    is_hu: true,
    not_hu_reason: null,
    shape_zyx: [13, 51, 52],
    spacing_mm: [0.6, 0.7, 3],
    number: 1,
    lps_from_ijk: [0.6, 0, 0, 1, 0, 0.7, 0, 2, 0, 0, 3, 4, 0, 0, 0, 1],
    value_range: [-1024, 3071],
    warnings: [],
    notes: [],
    quality: [],
    other_series: [],
    citation: null,
    off: [],
    interpolated_slices: [],
    slice_places: [],
    statement: null,
    tilt_deg: null,
    series: null,
    ct_name: null,
  },
};

function pose(poseId: number, pathMillimetres: number | null = null): PoseMessage {
  return {
    type: "pose",
    pose_id: poseId,
    lps_from_camera: [1, 0, 0, 7, 0, 1, 0, 8, 0, 0, 1, 9, 0, 0, 0, 1],
    mode: "path",
    path_mm: pathMillimetres,
    branch_id: 0,
    branch_name: null,
    generation: 0,
    lumen_mm: 9,
    inside: true,
    scope: null,
    key_frames_s: null,
    flight: null,
    by_device: false,
    back_to_route_mm: null,
  };
}

const from = (message: ServerMessage): AppEvent => ({ kind: "server", message });
const following = (state: AppState, ...events: AppEvent[]): AppState => events.reduce(reduce, state);

describe("poses", () => {
  it("A pose with a lower number than the current one is ignored.", () => {
    const state = following(INITIAL_STATE, from(pose(5, 10)), from(pose(4, 99)));
    expect(state.pose?.pose_id).toBe(5);
    expect(pathMm(state)).toBe(10);
  });

  it("After a new connection a pose with a lower number is accepted.", () => {
    const open = { kind: "connection", connection: { status: "open", reason: null, retryAtMs: null } } as const;
    expect(following(INITIAL_STATE, from(pose(50)), open, from(pose(1))).pose?.pose_id).toBe(1);
  });
});

const sent = (message: ClientMessage, number = 1): AppEvent => ({ kind: "sent", message, number });
const handled = (number: number): AppEvent => from({ type: "handled", number });
const sightReported = (sight: Partial<Sight>): AppEvent => from({ ...OPEN, sight: { ...OPEN.sight, ...sight } });

describe("look and sight", () => {
  it("A sent setting is shown before the server answers.", () => {
    const carm = { primary_deg: 12, secondary_deg: -3, mm_per_px: null, tone: "fluoroscopy" } as const;
    const state = following(
      INITIAL_STATE,
      from(OPEN),
      sent({ type: "set_carm", ...carm }),
      sent({ type: "set_slab", thickness_mm: 10, kind: "min" }),
      sent({ type: "set_shading", on: false }),
      sent({ type: "set_operator", position: "facing" }),
      sent({ type: "set_orbit", view: "tree", azimuth_deg: 5, elevation_deg: 6 }),
      sent({ type: "set_orbit", view: "tri-plane", azimuth_deg: 7, elevation_deg: 8 }),
    );
    expect(state.sight).toEqual({
      ...OPEN.sight,
      carm,
      slab: { thickness_mm: 10, kind: "min" },
      shading: false,
      orbits: { tree: { azimuth_deg: 5, elevation_deg: 6 }, "tri-plane": { azimuth_deg: 7, elevation_deg: 8 } },
    });
    expect(state.look).toEqual({ ...OPEN.look, operator: "facing" });
  });

  it("An older message of the server does not change a sent setting until the server has executed its command.", () => {
    const carm = (tone: "radiograph" | "fluoroscopy") => ({ ...FIRST_SIGHT.carm, tone });
    const first = sent({ type: "set_carm", ...carm("fluoroscopy") }, 3);
    let state = following(INITIAL_STATE, from(OPEN), first, sightReported({}), handled(2));
    expect(state.sight.carm.tone).toBe("fluoroscopy");
    state = following(state, sightReported({ carm: carm("fluoroscopy") }), handled(3));
    expect(state.local.sight).toEqual({});
    // After the command is done, the server's values apply immediately.
    expect(following(state, sightReported({ carm: carm("radiograph") })).sight.carm.tone).toBe("radiograph");
  });

  it("After this window's command is done, the value that another window has set is shown.", () => {
    const look = (fov_deg: number): AppEvent => from({ ...OPEN, look: { ...OPEN.look, fov_deg } });
    // The other window's command came first, so the server's message is older than this window's change.
    let state = following(INITIAL_STATE, from(OPEN), sent({ type: "set_fov", fov_deg: 100 }, 4), look(80));
    expect(state.look.fov_deg).toBe(100);
    expect(following(state, look(100), handled(4)).look.fov_deg).toBe(100);
    // The other window's command came last, so the server sends only its value.
    state = following(state, look(70), handled(4));
    expect(state.look.fov_deg).toBe(70);
  });

  it("A setting that the server refused returns to the server's value.", () => {
    const refused = [sent({ type: "set_fov", fov_deg: 100 }, 4), handled(4)];
    expect(following(INITIAL_STATE, from(OPEN), ...refused).look.fov_deg).toBe(OPEN.look.fov_deg);
  });

  it("A setting that waits to be sent is shown until it is sent; a new connection restores the server's value.", () => {
    const soon = sent({ type: "set_shading", on: false }, NOT_SENT);
    const open = { kind: "connection", connection: { status: "open", reason: null, retryAtMs: null } } as const;
    const state = following(INITIAL_STATE, from(OPEN), soon, sightReported({}), handled(9));
    expect(state.sight.shading).toBe(false);
    expect(following(state, open, sightReported({})).sight.shading).toBe(true);
  });

  it("After undo or a change of the scope the server's values replace the settings that were sent before.", () => {
    for (const then of [{ type: "undo" }, { type: "set_scope", scope: "ebus" }] as const) {
      const state = following(INITIAL_STATE, from(OPEN), sent({ type: "set_fov", fov_deg: 100 }), sent(then));
      expect(following(state, from({ ...OPEN, look: { ...OPEN.look, fov_deg: 80 } })).look.fov_deg).toBe(80);
    }
  });

  it("Every settable field exists in the initial look or sight.", () => {
    for (const { of, field } of Object.values(SETS)) {
      expect(Object.keys(of === "look" ? FIRST_LOOK : FIRST_SIGHT)).toContain(field);
    }
  });
});

describe("values that the user changes", () => {
  it("A dragged crosshair is shown at once, and an answer to an older drag does not move it back.", () => {
    const drag = (x: number, number: number): AppEvent => sent({ type: "set_crosshair", lps: [x, 0, 0] }, number);
    let state = following(INITIAL_STATE, from(OPEN), drag(1, 1), drag(2, 2));
    expect(crosshairLps(state)).toEqual([2, 0, 0]);
    state = following(state, sightReported({ crosshair_lps: [1, 0, 0] }), handled(1));
    expect(crosshairLps(state)).toEqual([2, 0, 0]);
    state = following(state, sightReported({ crosshair_lps: [2, 0, 0] }), handled(2));
    expect(state.local.sight).toEqual({});
    expect(crosshairLps(state)).toEqual([2, 0, 0]);
  });

  it("The selection is cleared when another case opens, also of the same CT, but not when the case is updated.", () => {
    const [open] = [OPEN.case];
    if (open === null) throw new Error("no case");
    const held = following(INITIAL_STATE, from(OPEN), { kind: "ui", change: { selected: 3 } });
    expect(following(held, from({ ...OPEN, case: { ...open, warnings: ["one"] } })).ui.selected).toBe(3);
    expect(following(held, from({ ...OPEN, case: { ...open, shape_zyx: [14, 51, 52] } })).ui.selected).toBeNull();
    // The message belongs to another case of the same CT.
    expect(following(held, from({ ...OPEN, case: { ...open, number: 2 } })).ui.selected).toBeNull();
  });

  it("The path slider shows the requested position until the server has executed the command.", () => {
    let state = following(INITIAL_STATE, from(OPEN), from(pose(1, 10)), sent({ type: "go_to", path_mm: 42 }, 2));
    expect(pathMm(state)).toBe(42);
    state = following(state, from(pose(2, 30)), handled(1));
    expect(pathMm(state)).toBe(42);
    state = following(state, from(pose(3, 42)), handled(2));
    expect(state.local.pathMm).toBeNull();
    expect(pathMm(state)).toBe(42);
  });

  it("The path slider shows the pose again after the user has steered.", () => {
    const slide = sent({ type: "go_to", path_mm: 42 });
    const steer = sent({ type: "steer", advance_mm: 1, yaw_rad: 0, pitch_rad: 0, roll_rad: 0 }, 2);
    expect(pathMm(following(INITIAL_STATE, from(pose(1, 10)), slide, steer))).toBe(10);
  });
});

describe("messages", () => {
  const error = (message: string): AppEvent => from({ type: "error", code: "x", message, action: null });
  const notice = (message: string): AppEvent => from({ type: "notice", message });

  it("The latest message is first, and a repeated message is shown once.", () => {
    const state = following(INITIAL_STATE, error("a"), error("b"), error("a"));
    expect(state.messages.map((message) => message.message)).toEqual(["a", "b"]);
  });

  it("An error stays until it is dismissed, but only the latest three notices stay.", () => {
    const many = Array.from({ length: 6 }, (_, index) => notice(`news ${index}`));
    let state = following(INITIAL_STATE, error("lost"), ...many);
    expect(state.messages.filter((message) => message.kind === "error")).toHaveLength(1);
    expect(state.messages.filter((message) => message.kind === "notice")).toHaveLength(3);
    const id = state.messages.find((message) => message.kind === "error")?.id ?? -1;
    state = following(state, { kind: "dismiss", id });
    expect(state.messages.some((message) => message.kind === "error")).toBe(false);
  });
});

describe("cases and jobs", () => {
  it("A new case opens at the Check step if it has findings, else at the Airways step.", () => {
    expect(following(INITIAL_STATE, from(OPEN)).ui.step).toBe("airways");
    const found = { ...OPEN, case: OPEN.case && { ...OPEN.case, quality: ["slices are 3.0 mm apart"] } };
    expect(following(INITIAL_STATE, from(found)).ui.step).toBe("check");
  });

  it("Closing a case clears its pose, tree, route, pictures and enlarged view.", () => {
    const tree = from({ type: "tree", tree: null, titles: [], measures: null, uncertain: [], absent: [] });
    const state = following(INITIAL_STATE, from(OPEN), tree, from(pose(3)), { kind: "ui", change: { full: "axial" } });
    const closed = following(state, from(EMPTY));
    expect([closed.pose, closed.tree, closed.route, closed.frames]).toEqual([null, null, null, {}]);
    expect(closed.ui.full).toBeNull();
  });

  it("A job is shown until it is done.", () => {
    const job = (fraction: number): AppEvent =>
      from({ type: "progress", job_id: "j", title: "opening", what: "", fraction, seconds_left: null });
    const running = following(INITIAL_STATE, job(0.1), job(0.7));
    expect(running.jobs).toHaveLength(1);
    expect(running.jobs[0]?.fraction).toBe(0.7);
    expect(following(running, from({ type: "done", job_id: "j", outcome: "done" })).jobs).toEqual([]);
  });

  describe("preview of a CT that is being opened", () => {
    const slice = { picture: "", number: 3, num_slices: 5, height_lps_mm: -12, width_mm: 9, height_mm: 9, is_hu: true };
    const none = { list_id: null, series: [], chosen: null, num_patients: 1, slice: null };
    const preview = (jobId: string | null, listId = jobId) =>
      from({ type: "opening", job_id: jobId, ...none, ...(jobId === null ? {} : { list_id: listId, slice }) });
    const picture = (listId: string | null) =>
      from({ type: "series_picture", key: "4", picture: "a", list_id: listId });
    const shown = following(INITIAL_STATE, from(OPEN), preview("job-1"));
    const lost = { status: "lost", reason: null, retryAtMs: 5 } as const;

    it.each<[string, AppEvent]>([
      ["the server removes it", preview(null)],
      ["its job ends", from({ type: "done", job_id: "job-1", outcome: "failed" })],
      ["the user cancels its job", sent({ type: "cancel", job_id: "job-1" })],
      ["the CT is shown", from({ ...OPEN, case: OPEN.case && { ...OPEN.case, number: 2 } })],
      ["the connection is lost", { kind: "connection", connection: lost }],
    ])("It is shown until %s.", (_why, event) => {
      expect(shown.opening?.message.slice).toEqual(slice);
      expect(following(shown, event).opening).toBeNull();
    });

    it("It stays after the end of another job, and that of a cancelled job is not shown later.", () => {
      const other = from({ type: "done", job_id: "job-7", outcome: "done" });
      expect(following(shown, other, sent({ type: "cancel", job_id: "job-7" })).opening).not.toBeNull();
      expect(following(shown, sent({ type: "cancel", job_id: "job-1" }), preview("job-1")).opening).toBeNull();
    });

    it("Pictures of its series and of the open CT's series are not mixed, and stay while another one is opened.", () => {
      const pictured = following(shown, picture("job-1"), picture("job-0"));
      expect([pictured.opening?.pictures, pictured.seriesPictures]).toEqual([{ "4": "a" }, {}]);
      expect(following(shown, picture(null)).opening?.pictures).toEqual({});
      const other = following(pictured, preview("job-2", "job-1"));
      expect([other.opening?.message.job_id, other.opening?.pictures]).toEqual(["job-2", { "4": "a" }]);
      expect(following(pictured, preview("job-3")).opening?.pictures).toEqual({});
    });

    it("Its number and its position are stated.", () => {
      expect(sliceText(slice)).toBe("Slice 3 of 5, I 12.0 mm");
      expect(sliceText({ ...slice, height_lps_mm: 0.04 })).toBe("Slice 3 of 5, S 0.0 mm");
    });
  });

  describe("dialog of the PACS", () => {
    const study = {
      study_uid: "1.2",
      patient_name: "MUSTER^ERIKA",
      patient_id: "17",
      date: "2026-11-03",
      description: "Chest",
      modalities: "CT",
      num_series: 2,
    };
    const found = from({ type: "pacs_studies", name: "hospital", studies: [study], has_more: false });
    const show = (pacsOpen: boolean): AppEvent => ({ kind: "ui", change: { pacsOpen } });
    const lost = from({
      type: "pacs_problem",
      task: "get",
      code: "pacs.incomplete",
      problem: "2 images did not arrive",
      target_id: null,
    });

    it("No name stays when it closes, also without a connection to the server.", () => {
      const open = following(INITIAL_STATE, show(true), found);
      expect(JSON.stringify(open)).toContain("MUSTER");
      expect(JSON.stringify(following(open, show(false)))).not.toContain("MUSTER");
    });

    it("No name that arrives after its end is stored.", () => {
      const state = following(INITIAL_STATE, show(true), show(false), found);
      expect(JSON.stringify(state)).not.toContain("MUSTER");
    });

    it("A retrieval that fails while it is closed is reported as an error.", () => {
      expect(following(INITIAL_STATE, lost).messages.map(({ code }) => code)).toEqual(["pacs.incomplete"]);
      const open = following(INITIAL_STATE, show(true), lost);
      expect([open.messages, open.pacs.problem?.task]).toEqual([[], "get"]);
    });
  });

  it("The safety notice disappears when its acceptance is sent.", () => {
    const start = from({
      type: "start",
      notice_accepted: false,
      recent: [],
      demos: [],
      scopes: [],
      storage: null,
      no_video: null,
      hints_read: false,
    });
    expect(following(INITIAL_STATE, start, sent({ type: "accept_notice" })).start?.notice_accepted).toBe(true);
  });
});
