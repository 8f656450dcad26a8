// Generated from python/carina/commands and python/carina/server/wire/messages.py by
// `python -m carina.server.wire.generate`. Do not edit.

export const WIRE_VERSION = 7;

export const CLOSE_CODES = {
  "protocol.malformed": 4400,
  "protocol.not-authorised": 4401,
  "protocol.version": 4402,
  "protocol.order": 4403,
  "protocol.taken-over": 4409,
  "protocol.case-closed": 4410,
  "protocol.slow-client": 4413,
  "protocol.flood": 4414,
  "protocol.too-many-windows": 4429,
  "protocol.watching-ended": 4410,
} as const;

/** Largest angle of an opening straight ahead, degrees; least ratio of the other openings' angles to it. */
export const STRAIGHT_AHEAD = { most_deg: 6.0, times: 2.0 } as const;

/** 4x4, row-major. */
export type Matrix4 = readonly number[];
export type ViewName = "airway" | "axial" | "coronal" | "curved" | "cut-plane" | "drr" | "sagittal" | "straightened" | "tree" | "tri-plane" | "xray-axial" | "xray-coronal" | "xray-sagittal";
export type Outline = "none" | "octagon" | "round";

/** Open a file or folder of this machine. */
export interface OpenPathMessage {
  readonly type: "open_path";
  readonly path: string;
}

/** Open another DICOM series of the folder from which the CT on screen was opened, or of a folder being opened. */
export interface OpenSeriesMessage {
  readonly type: "open_series";
  readonly key: string;
  readonly job_id?: string | null;
}

/** Open a case that is bundled with Carina. */
export interface OpenDemoMessage {
  readonly type: "open_demo";
  readonly name: "patient" | "phantom";
}

/** Open a case of `start.recent`, by its ID; the path of the case is never sent. */
export interface OpenRecentMessage {
  readonly type: "open_recent";
  readonly recent_id: string;
}

/** Start a new case of the open CT; the present case stays in the list. */
export interface BeginAnewMessage {
  readonly type: "begin_anew";
}

/** Give a case in the list a name; null restores the name from the scan.

    The name stays on this machine: no saved or exported file contains it. */
export interface RenameCaseMessage {
  readonly type: "rename_case";
  readonly recent_id: string;
  readonly title: string | null;
}

/** Delete a case from the list, and its cached CT; the case can be restored for a day. */
export interface ForgetCaseMessage {
  readonly type: "forget_case";
  readonly recent_id: string;
}

/** Restore a case that the user deleted within the last 24 hours. */
export interface RestoreCaseMessage {
  readonly type: "restore_case";
  readonly recent_id: string;
}

/** Delete all deleted cases from the disk permanently. */
export interface EmptyForgottenMessage {
  readonly type: "empty_forgotten";
}

/** Delete the cached CTs; later openings read the CTs from their files. */
export interface EmptyCtCacheMessage {
  readonly type: "empty_ct_cache";
}

/** Set whether opened CTs are cached for faster opening; off deletes the cached CTs. */
export interface KeepCtsMessage {
  readonly type: "keep_cts";
  readonly on: boolean;
}

/** Close the case and return to the start page. */
export interface CloseCaseMessage {
  readonly type: "close_case";
}

/** Stop a background job that `progress` lists. */
export interface CancelMessage {
  readonly type: "cancel";
  readonly job_id: string;
}

/** Undo the case's last change that was not undone. */
export interface UndoMessage {
  readonly type: "undo";
}

/** Redo the case's last undone change. */
export interface RedoMessage {
  readonly type: "redo";
}

/** Write the whole case to one file, which is then updated while the case is open.

    The file is not needed against loss: Carina always saves the case on this machine. */
export interface SaveCaseMessage {
  readonly type: "save_case";
  readonly path?: string | null;
  readonly replace?: boolean;
}

/** Undo or redo changes until this number of steps of the history is in effect, counted from 0. */
export interface GoToStepMessage {
  readonly type: "go_to_step";
  readonly step: number;
}

/** Find the airways again from this root. */
export interface SetRootMessage {
  readonly type: "set_root";
  readonly lps: readonly [number, number, number];
}

/** Find the airways again with this threshold; null uses Carina's own. */
export interface SetLumenThresholdMessage {
  readonly type: "set_lumen_threshold";
  readonly value: number | null;
}

/** Add a target, with the path to it. */
export interface AddTargetMessage {
  readonly type: "add_target";
  readonly lps: readonly [number, number, number];
  readonly cost?: "lumen" | "paper" | "walls";
  readonly root_lps?: readonly [number, number, number] | null;
}

/** Delete a target. */
export interface RemoveTargetMessage {
  readonly type: "remove_target";
  readonly target_id: string;
}

/** Set the route to a target or to the end of a branch; at most one of both, neither for no route. */
export interface ChooseRouteMessage {
  readonly type: "choose_route";
  readonly target_id?: string | null;
  readonly branch_id?: number | null;
}

/** Add a branch to a point, by the least-cost path through the lumen or, beyond it, by the best evidence. */
export interface EditAddBranch {
  readonly kind: "add-branch";
  readonly lps: readonly [number, number, number];
  readonly even_without_evidence?: boolean;
}

/** Delete a branch with all its descendants, from a position along it. */
export interface EditCutBranch {
  readonly kind: "cut-branch";
  readonly branch_id: number;
  readonly at_mm?: number;
}

/** Continue the airways from the nearest tree point through mucus or tumour to a point in air beyond it. */
export interface EditBridge {
  readonly kind: "bridge";
  readonly lps: readonly [number, number, number];
}

/** Set another root of all paths; branches whose direction changes are reversed. */
export interface EditMoveRoot {
  readonly kind: "move-root";
  readonly lps: readonly [number, number, number];
}

/** Move the point where a branch ends and its children start; the adjoining centrelines follow. */
export interface EditMoveFork {
  readonly kind: "move-fork";
  readonly branch_id: number;
  readonly lps: readonly [number, number, number];
}

/** Add voxels to the lumen, or remove them, by a stroke of a brush. */
export interface EditPaintLumen {
  readonly kind: "paint-lumen";
  readonly points_lps: readonly (readonly [number, number, number])[];
  readonly radius_mm: number;
  readonly plane?: "axial" | "ball" | "coronal" | "sagittal";
  readonly erase?: boolean;
}

/** Smooth a branch's centreline between its fixed ends. */
export interface EditSmoothBranch {
  readonly kind: "smooth-branch";
  readonly branch_id: number;
}

/** Rename a branch, or restore its automatic name. */
export interface EditRenameBranch {
  readonly kind: "rename-branch";
  readonly branch_id: number;
  readonly name: string | null;
}

/** Edit the airway tree: a job, and one step of undo. */
export interface EditTreeMessage {
  readonly type: "edit_tree";
  readonly edit: EditAddBranch | EditCutBranch | EditBridge | EditMoveRoot | EditMoveFork | EditPaintLumen | EditSmoothBranch | EditRenameBranch;
}

/** Remove a device that was disconnected from the list of devices. */
export interface DeviceGoneMessage {
  readonly type: "device_gone";
  readonly device: string;
}

/** Let a device move the tip from now on. */
export interface TakeDeviceMessage {
  readonly type: "take_device";
  readonly device: string;
}

/** Set how a device moves the tip: absolute (registered position), relative (hand movement), or along the path. */
export interface SetControlMessage {
  readonly type: "set_control";
  readonly control: "absolute" | "path" | "relative";
}

/** Mapping from the movement of a device to the movement of the tip.

    Examples
    --------
    >>> DeviceControls(gain_mm=0.5, clutch="hold")
    DeviceControls(gain_mm=0.5, clutch='hold') */
export interface DeviceControls {
  readonly gain_mm?: number;
  readonly gain_turn?: number;
  readonly clutch?: "always" | "hold";
  readonly speed_mm_s?: number;
  readonly turn_rad_s?: number;
  readonly lever_inverted?: boolean;
  readonly lever_rad?: number;
  readonly filter_on?: boolean;
  readonly min_cutoff_hz?: number;
  readonly beta_per_mm?: number;
  readonly beta_per_rad?: number;
  readonly derivative_cutoff_hz?: number;
}

/** Set gains, clutch, speeds and filter of the input devices. */
export interface SetControlsMessage {
  readonly type: "set_controls";
  readonly controls: DeviceControls;
}

/** Register a tracker to the patient by pairs of points (3 or more); no pairs remove the registration. */
export interface CalibrateMessage {
  readonly type: "calibrate";
  readonly device: string;
  readonly tracker_mm: readonly (readonly [number, number, number])[];
  readonly patient_lps: readonly (readonly [number, number, number])[];
}

/** Set which kind of point the pen's first button marks at the pen's tip (`pen`); null lets it cycle the control.

    `start` is the start of paths of the costs `walls` and `paper`: windows receive the message `start_marked`. */
export interface ArmPenMessage {
  readonly type: "arm_pen";
  readonly tool: "root" | "start" | "target" | null;
  readonly cost?: "lumen" | "paper" | "walls";
  readonly root_lps?: readonly [number, number, number] | null;
}

/** Move the tip to the registered pen at once in absolute control, instead of gradually. */
export interface JoinPenMessage {
  readonly type: "join_pen";
}

/** End the recording of the flight. */
export interface StopRecordingMessage {
  readonly type: "stop_recording";
}

/** Rename a recorded flight. */
export interface RenameFlightMessage {
  readonly type: "rename_flight";
  readonly number: number;
  readonly name: string;
}

/** Set the description of a recorded flight; an empty text removes it. */
export interface DescribeFlightMessage {
  readonly type: "describe_flight";
  readonly number: number;
  readonly words: string;
}

/** Move a recorded flight earlier (below 0) or later in the list. */
export interface MoveFlightMessage {
  readonly type: "move_flight";
  readonly number: number;
  readonly by: number;
}

/** Set the tip to its pose at a time of a recorded flight and enter free mode.

    The command is a job if the flight must be read first. */
export interface FlyFlightMessage {
  readonly type: "fly_flight";
  readonly number: number;
  readonly time_s: number;
  readonly goes_on?: boolean;
}

/** Delete a recorded flight. The deletion is not a step of the history, so undo does not restore the flight. */
export interface RemoveFlightMessage {
  readonly type: "remove_flight";
  readonly number: number;
}

/** Move the tip in the camera's axes: forward, yaw right, pitch up, roll clockwise as the camera sees it. */
export interface SteerMessage {
  readonly type: "steer";
  readonly advance_mm: number;
  readonly yaw_rad: number;
  readonly pitch_rad: number;
  readonly roll_rad: number;
}

/** Set the mode of movement: free, or along the path. */
export interface SetModeMessage {
  readonly type: "set_mode";
  readonly mode: "free" | "path" | "scope";
}

/** Change between free movement and movement along the path, without a jump of the picture. */
export interface ToggleModeMessage {
  readonly type: "toggle_mode";
}

/** Go to a position on the path and enter path mode. */
export interface GoToMessage {
  readonly type: "go_to";
  readonly path_mm: number;
}

/** Go to the next fork along the path. */
export interface NextForkMessage {
  readonly type: "next_fork";
}

/** Go back to the previous fork along the path. */
export interface PreviousForkMessage {
  readonly type: "previous_fork";
}

/** Move the tip to a point, keep the direction of view, and enter free mode. */
export interface PlaceMessage {
  readonly type: "place";
  readonly lps: readonly [number, number, number];
}

/** Move the tip in front of a point of the airways, look at it, set the crosshair to it, and enter free mode.

    Without a branch the nearest branch is used. */
export interface ShowPlaceMessage {
  readonly type: "show_place";
  readonly lps: readonly [number, number, number];
  readonly branch_id: number | null;
}

/** Roll the picture so that the operator's up direction is up. */
export interface LevelHorizonMessage {
  readonly type: "level_horizon";
}

/** Turn the view back to the direction of the path. */
export interface ResetLookMessage {
  readonly type: "reset_look";
}

/** Switch the simulated breathing of the airway view on or off, or change it; not a step of undo.

    Positions, slices and radiographs remain those in the CT at rest. */
export interface SetBreathingMessage {
  readonly type: "set_breathing";
  readonly on: boolean;
  readonly movement_mm?: number;
  readonly period_s?: number;
}

/** Let the patient cough once, now, while the simulated breathing is on. */
export interface CoughMessage {
  readonly type: "cough";
}

/** Set the position of the operator: at the patient's head, or facing the patient. */
export interface SetOperatorMessage {
  readonly type: "set_operator";
  readonly position: "facing" | "head";
}

/** Append the present pose as the last key frame. */
export interface KeyFrameAdd {
  readonly kind: "add";
}

/** Replace the pose of a key frame by the present pose. */
export interface KeyFrameUpdate {
  readonly kind: "update";
  readonly key_id: string;
}

/** Move a key frame earlier (below 0) or later in the order. */
export interface KeyFrameMove {
  readonly kind: "move";
  readonly key_id: string;
  readonly by: number;
}

/** Rename a key frame; null uses the name of its branch. */
export interface KeyFrameRename {
  readonly kind: "rename";
  readonly key_id: string;
  readonly name: string | null;
}

/** Set the speed of the leg to a key frame; null uses the speed of the flight. */
export interface KeyFrameSpeed {
  readonly kind: "speed";
  readonly key_id: string;
  readonly speed_mm_s: number | null;
}

/** Delete a key frame from the flight. */
export interface KeyFrameRemove {
  readonly kind: "remove";
  readonly key_id: string;
}

/** Change the list of key frames; each command is one step of undo. */
export interface EditKeyFramesMessage {
  readonly type: "edit_key_frames";
  readonly edit: KeyFrameAdd | KeyFrameUpdate | KeyFrameMove | KeyFrameRename | KeyFrameSpeed | KeyFrameRemove;
}

/** Set how the flight passes through the key frames; null keeps a setting. Undoable. */
export interface SetKeyFrameFlightMessage {
  readonly type: "set_key_frame_flight";
  readonly speed_mm_s?: number | null;
  readonly through?: "airways" | "space" | null;
}

/** Set the tip to the pose of a key frame and enter free mode. */
export interface ShowKeyFrameMessage {
  readonly type: "show_key_frame";
  readonly key_id: string;
}

/** Set the tip to its pose at a time of the flight through the key frames and enter free mode. */
export interface FlyKeyFramesMessage {
  readonly type: "fly_key_frames";
  readonly time_s: number;
  readonly goes_on?: boolean;
}

/** Set the field of view of the airway view: the full angle across the shorter side of its picture. */
export interface SetFovMessage {
  readonly type: "set_fov";
  readonly fov_deg: number;
}

/** Set the outline of the airway picture: round, octagonal or the full frame. */
export interface SetOutlineMessage {
  readonly type: "set_outline";
  readonly outline: "none" | "octagon" | "round";
}

/** Use an instrument of the library for the airway view, with its field of view and outline, and for all plans.

    Null is a pinhole camera; the plans then keep their instrument. */
export interface SetScopeMessage {
  readonly type: "set_scope";
  readonly scope: string | null;
}

/** Set the transfer function: exactly one of a preset's name and a `carina-transfer` document. */
export interface SetTransferMessage {
  readonly type: "set_transfer";
  readonly preset?: string | null;
  readonly document?: Readonly<Record<string, unknown>> | null;
}

/** Set the point that slices and the tri-plane view show; null follows the tip. */
export interface SetCrosshairMessage {
  readonly type: "set_crosshair";
  readonly lps: readonly [number, number, number] | null;
}

/** Set the grey window of all slice views; raw values where the volume is not in HU. */
export interface SetWindowMessage {
  readonly type: "set_window";
  readonly width_hu: number;
  readonly level_hu: number;
}

/** Set thickness and kind of the slab of slices and views along the route; 0 mm are thin slices. */
export interface SetSlabMessage {
  readonly type: "set_slab";
  readonly thickness_mm: number;
  readonly kind: "max" | "mean" | "min";
}

/** Set the scale of a slice (mm_per_px) or the width of the cut-plane (extent_mm); null shows the whole area. */
export interface SetZoomMessage {
  readonly type: "set_zoom";
  readonly mm_per_px?: number | null;
  readonly extent_mm?: number | null;
  readonly centre_lps?: readonly [number, number, number] | null;
  readonly view: "axial" | "coronal" | "cut-plane" | "sagittal";
}

/** Set the camera of an external view; null as distance fits the view to its content. */
export interface SetOrbitMessage {
  readonly type: "set_orbit";
  readonly azimuth_deg: number;
  readonly elevation_deg: number;
  readonly distance_mm?: number | null;
  readonly view: "tree" | "tri-plane";
}

/** Set the angles of the radiograph's C-arm (LAO and cranial above 0) and the scale at its centre; null fits. */
export interface SetCarmMessage {
  readonly type: "set_carm";
  readonly primary_deg: number;
  readonly secondary_deg: number;
  readonly mm_per_px: number | null;
  readonly tone: "fluoroscopy" | "radiograph";
}

/** Set the angle of the cutting plane of the views along the route, and their scale; null fits the whole route. */
export interface SetReformationMessage {
  readonly type: "set_reformation";
  readonly turn_deg: number;
  readonly mm_per_px: number | null;
}

/** Switch the light at the tip on or off. */
export interface SetShadingMessage {
  readonly type: "set_shading";
  readonly on: boolean;
}

/** Switch the decoration of the wall on or off: texture, vessels, rings and others, which no CT shows. */
export interface SetTextureMessage {
  readonly type: "set_texture";
  readonly on: boolean;
}

/** Set the casting method, leaping or the brute-force reference; the pictures are the same. */
export interface SetMethodMessage {
  readonly type: "set_method";
  readonly method: "brute" | "leap";
}

/** Answer `state.mask_question`: the label of the airways, and whether to resample. */
export interface AnswerMaskMessage {
  readonly type: "answer_mask";
  readonly label?: number | null;
  readonly resample?: boolean;
}

/** Discard the imported mask about which `state.mask_question` asks. */
export interface DismissMaskMessage {
  readonly type: "dismiss_mask";
}

/** Movement of a target that was measured from a second CT. */
export interface MeasuredMovement {
  readonly shift_lps: readonly [number, number, number];
  readonly error_mm: number;
  readonly notes?: readonly string[];
}

/** Place of the scope's tip and the aim, which the user has chosen with a pair of route and instrument. */
export interface ChosenPlace {
  readonly branch_id: number;
  readonly along_mm: number;
  readonly aim?: number;
}

/** Plan the routes to a target again with other options; another scope is that of the whole case (`SetScope`). */
export interface SetPlanOptionsMessage {
  readonly type: "set_plan_options";
  readonly scope?: string;
  readonly tool?: string;
  readonly vessel_margin_mm?: number;
  readonly moved_mm?: number | null;
  readonly movement?: MeasuredMovement | null;
  readonly entry_mm?: number | null;
  readonly carina_depth_mm?: number | null;
  readonly place?: ChosenPlace | null;
  readonly target_id: string;
}

/** Measure the movement of a target from a second CT of the patient, a file, folder or case of this machine. */
export interface MeasureMovementMessage {
  readonly type: "measure_movement";
  readonly target_id: string;
  readonly path: string;
}

/** Measure the movement of a target from the CT of a case of `start.recent`, by its ID. */
export interface MeasureMovementFromCaseMessage {
  readonly type: "measure_movement_from_case";
  readonly target_id: string;
  readonly recent_id: string;
}

/** Set name, description and rank of a target. */
export interface DescribeTargetMessage {
  readonly type: "describe_target";
  readonly target_id: string;
  readonly called: string;
  readonly remark?: string;
  readonly rank?: number;
}

/** Choose one of the routes planned to a target; the flight then leads to the scope's standing point. */
export interface ChoosePlannedRouteMessage {
  readonly type: "choose_planned_route";
  readonly target_id: string;
  readonly number?: number;
}

/** Choose a route together with the scope and the tool that reach its end: a pair of `plans.pairs`. */
export interface ChoosePairMessage {
  readonly type: "choose_pair";
  readonly scope?: string;
  readonly tool?: string;
  readonly target_id: string;
  readonly route: string;
}

/** Store which scopes of the library are available here; pairs of other scopes are listed separately. */
export interface SetAvailableScopesMessage {
  readonly type: "set_available_scopes";
  readonly scopes: readonly string[] | null;
}

/** Put the tip at the viewpoint of a turn of the chosen route, as in the list of turns with clock positions. */
export interface SeeTurnMessage {
  readonly type: "see_turn";
  readonly number: number;
}

/** Store the simulated drive of an instrument on the chosen route as a flight of the case. */
export interface KeepDriveMessage {
  readonly type: "keep_drive";
  readonly scope: string;
}

/** Convert a target beside an airway into a nodule that is segmented from its point. */
export interface GrowTargetMessage {
  readonly type: "grow_target";
  readonly target_id: string;
}

/** Confirm that a target is what the user intends, despite doubts; its routes are planned only then. */
export interface ConfirmTargetMessage {
  readonly type: "confirm_target";
  readonly target_id: string;
  readonly doubts: readonly string[];
}

/** Move a target's boundary outward or inward, to a long axial diameter. */
export interface ResizeTargetMessage {
  readonly type: "resize_target";
  readonly target_id: string;
  readonly diameter_mm: number;
}

/** Add to a target, or remove from it, by a stroke of a ball-shaped brush. */
export interface BrushTargetMessage {
  readonly type: "brush_target";
  readonly target_id: string;
  readonly stroke_lps: readonly (readonly [number, number, number])[];
  readonly brush_mm: number;
  readonly takes_away?: boolean;
}

/** Set the aim of the needle: the centre of a target, or its centre and its periphery. */
export interface AimTargetMessage {
  readonly type: "aim_target";
  readonly target_id: string;
  readonly periphery: boolean;
}

/** Mark a ball as a target, where the CT shows no boundary. */
export interface MarkSphereMessage {
  readonly type: "mark_sphere";
  readonly lps: readonly [number, number, number];
  readonly diameter_mm: number;
}

/** Map the anatomy around the targets: vessels, fissures and lobes of both lungs, and the stations for EBUS. */
export interface MapLungsMessage {
  readonly type: "map_lungs";
}

/** Map the parts of the lungs that an instrument's tip and tool can reach. */
export interface MapReachMessage {
  readonly type: "map_reach";
  readonly scope?: string;
  readonly tool?: string;
}

/** Begin an attempt at a task: insert the scope into the trachea and record the flight until the task ends.

    The command is a job if the wall of the airways must be computed first. */
export interface StartTaskMessage {
  readonly type: "start_task";
  readonly task: string;
}

/** Pause the attempt, or continue it: the clock stops and the tip does not move; nothing without an attempt.

    A paused attempt is scored, but does not count in a verdict. */
export interface PauseTaskMessage {
  readonly type: "pause_task";
  readonly paused: boolean;
}

/** End the attempt, and score its flight; nothing happens if no task is running. */
export interface StopTaskMessage {
  readonly type: "stop_task";
}

/** Score a recorded flight, by a job. */
export interface ScoreFlightMessage {
  readonly type: "score_flight";
  readonly number: number;
  readonly task?: string | null;
}

/** Read the tasks of teachers and the learners again, which other programs may have changed. */
export interface ReadTrainingFilesMessage {
  readonly type: "read_training_files";
}

/** Mark a recorded flight as the expert's, with which other flights are compared; null removes the mark. */
export interface MarkExpertMessage {
  readonly type: "mark_expert";
  readonly number: number | null;
}

/** Compare a scored flight with the expert's, by a job.

    Without a mark, the simulated drive of the instrument's verdict is stored as a flight and marked. */
export interface CompareFlightMessage {
  readonly type: "compare_flight";
  readonly number: number;
}

/** Add a learner to the course of this machine by a pseudonym, and choose this learner. */
export interface AddLearnerMessage {
  readonly type: "add_learner";
  readonly name: string;
}

/** Choose the learner whose scored attempts are stored from now on; null stores no attempts. */
export interface ChooseLearnerMessage {
  readonly type: "choose_learner";
  readonly name: string | null;
}

/** Delete a learner with all stored attempts; the flights in cases remain. */
export interface RemoveLearnerMessage {
  readonly type: "remove_learner";
  readonly name: string;
}

/** Begin a quiz on the open case: place the tip for the first question.

    The command is a job if the wall of the airways must be computed first. */
export interface StartQuizMessage {
  readonly type: "start_quiz";
  readonly kind: "name-opening" | "slices" | "where-are-you";
  readonly seed?: number;
  readonly num?: number;
}

/** Answer the question of the running quiz; a second answer to one question is refused. */
export interface AnswerQuizMessage {
  readonly type: "answer_quiz";
  readonly name: string;
}

/** Place the tip for the next question of the quiz; after the last question the quiz remains with its result. */
export interface NextQuestionMessage {
  readonly type: "next_question";
}

/** Place the tip again at the pose of the present question of the quiz. */
export interface RepeatQuestionMessage {
  readonly type: "repeat_question";
}

/** End the quiz; nothing happens if none is running. */
export interface StopQuizMessage {
  readonly type: "stop_quiz";
}

/** First message of a client. */
export interface ClientHelloMessage {
  readonly type: "hello";
  readonly wire_version: number;
  readonly token?: string | null;
}

/** Open the files sent to `/api/upload`. */
export interface OpenUploadMessage {
  readonly type: "open_upload";
  readonly upload_id: string;
}

/** Take the mask sent to `/api/upload` as the airways of the open case; undoable. */
export interface ImportMaskMessage {
  readonly type: "import_mask";
  readonly upload_id: string;
}

/** Take the file sent to `/api/upload` as a target: a mask, a DICOM SEG or an RTSTRUCT; undoable. */
export interface ImportTargetMessage {
  readonly type: "import_target";
  readonly upload_id: string;
  readonly structure?: string | null;
}

/** Measure the movement of a target from the second CT sent to `/api/upload`; undoable. */
export interface MeasureUploadMessage {
  readonly type: "measure_upload";
  readonly target_id: string;
  readonly upload_id: string;
}

/** A visible view and its size in device pixels. */
export interface ViewSize {
  readonly view: "airway" | "axial" | "coronal" | "curved" | "cut-plane" | "drr" | "sagittal" | "straightened" | "tree" | "tri-plane" | "xray-axial" | "xray-coronal" | "xray-sagittal";
  readonly width: number;
  readonly height: number;
}

/** Views on the screen; only these views are rendered. */
export interface LayoutMessage {
  readonly type: "layout";
  readonly views: readonly ViewSize[];
}

/** Report that a picture was decoded; acknowledgements that the page has delayed follow one another. */
export interface AckMessage {
  readonly type: "ack";
  readonly frame_id: number;
}

/** Request the value of the voxel at a point; the answer is `value`. */
export interface ProbeMessage {
  readonly type: "probe";
  readonly lps: readonly [number, number, number];
}

/** Request the wall position under a pixel of an airway image; the answer is `picked`. */
export interface PickMessage {
  readonly type: "pick";
  readonly pick_id: number;
  readonly frame_id: number;
  readonly column: number;
  readonly row: number;
}

/** Request the path from the root to a point under the cursor; only the newest is answered, by `live_path`.

    The request contains either a point or a position in an airway picture, as in `pick`. For a position, the path
    ends in the lumen in front of the wall at this position. */
export interface AskLivePathMessage {
  readonly type: "live_path";
  readonly request_id: number;
  readonly lps: readonly [number, number, number] | null;
  readonly frame_id: number | null;
  readonly column: number | null;
  readonly row: number | null;
}

/** Request the measurements along a branch; only the newest request is answered, by `branch_detail`. */
export interface AskBranchDetailMessage {
  readonly type: "branch_detail";
  readonly request_id: number;
  readonly branch_id: number;
}

/** Set the frame rate of the moving airway view; resolution is reduced first, then the ray step is enlarged. */
export interface SetFrameRateMessage {
  readonly type: "set_frame_rate";
  readonly rate_hz: number;
}

/** Choose the processor of airway views for all windows and later starts; the answer is `processor_choice`. */
export interface SetProcessorMessage {
  readonly type: "set_processor";
  readonly choice: "auto" | "cpu" | "gpu";
}

/** Select the layers of the lung map on the slices of this window; the default is all layers. */
export interface SetLayersMessage {
  readonly type: "set_layers";
  readonly layers: readonly ("fissures" | "lobes" | "reach" | "vessels")[];
}

/** Request a picture of each series of a folder, by a job; each answer is a `series_picture`. */
export interface AskSeriesPicturesMessage {
  readonly type: "ask_series_pictures";
  readonly list_id?: string | null;
}

/** Stop the job of `ask_series_pictures`, because the window has closed the list of series. */
export interface StopSeriesPicturesMessage {
  readonly type: "stop_series_pictures";
}

/** Request the present disk usage of the cases and their CTs; the answer is `start`. */
export interface AskStorageMessage {
  readonly type: "ask_storage";
}

/** Open the viewing page in the local network with a new certificate and link, or close it.

    If the page is open, `on` leaves the link unchanged. */
export interface SetWatchPageMessage {
  readonly type: "set_watch_page";
  readonly on: boolean;
  readonly learners?: boolean;
}

/** Disconnect an observer, and replace the link so that the previous link no longer works. */
export interface SendAwayMessage {
  readonly type: "send_away";
  readonly number: number;
}

/** Confirmation that the user read the notice "Not a medical device". */
export interface AcceptNoticeMessage {
  readonly type: "accept_notice";
}

/** Report that the user has read or closed the hints of the first minute. */
export interface ReadHintsMessage {
  readonly type: "read_hints";
}

/** Sample of an input device that is connected to the window.

    A sample contains exactly one of: an orientation (with or without a position), axes, or the controls of a scope
    handle. */
export interface DeviceSampleMessage {
  readonly type: "device_sample";
  readonly device: string;
  readonly position_mm: readonly [number, number, number] | null;
  readonly orientation_wxyz: readonly [number, number, number, number] | null;
  readonly buttons: number;
  readonly time_s: number;
  readonly axes: readonly number[] | null;
  readonly handle: readonly [number, number, number] | null;
  readonly advance: number;
}

/** Request to connect to a device by kind and address, such as fastrak:PORT or openigtlink:HOST:PORT. */
export interface ConnectDeviceMessage {
  readonly type: "connect_device";
  readonly address: string;
}

/** Request to close the connection to a device. */
export interface DisconnectDeviceMessage {
  readonly type: "disconnect_device";
  readonly address: string;
}

/** Request to publish the tip by OpenIGTLink on a port of this machine (0: any free port); null stops publishing. */
export interface PublishTipMessage {
  readonly type: "publish_tip";
  readonly port: number | null;
}

/** Request to open the phone page to the local network, with a new certificate and link, or to close the page. */
export interface SetPhoneMessage {
  readonly type: "set_phone";
  readonly on: boolean;
}

/** Request for device values: a few times a second (`on`), or only after changes. */
export interface WatchDevicesMessage {
  readonly type: "watch_devices";
  readonly on: boolean;
}

/** Request to record the flight into the case, or into a file on this machine if the case is not stored. */
export interface StartRecordingMessage {
  readonly type: "start_recording";
}

/** Request the result of a click with the tool *Mark target*; only the newest is answered, by `target_mark`. */
export interface AskTargetMarkMessage {
  readonly type: "target_mark";
  readonly request_id: number;
  readonly lps: readonly [number, number, number];
}

/** Request for a preview of an edit under the cursor; the server answers the newest request by `edit_preview`.

    The place is either a point, or a position in an airway image, as in `live_path`. Only `move-fork` names a
    branch. */
export interface AskEditPreviewMessage {
  readonly type: "preview_edit";
  readonly request_id: number;
  readonly lps: readonly [number, number, number] | null;
  readonly frame_id: number | null;
  readonly column: number | null;
  readonly row: number | null;
  readonly tool: "add-branch" | "bridge" | "move-fork";
  readonly branch_id: number | null;
  readonly with_names: boolean;
}

/** Request to load key frames from the file sent to `/api/upload`; undoable. */
export interface OpenKeyFramesMessage {
  readonly type: "open_key_frames";
  readonly upload_id: string;
}

/** Request the saved connections; the answer is `pacs_connections`. */
export interface AskPacsMessage {
  readonly type: "ask_pacs";
}

/** Fields of a saved connection, without its password. */
export interface PacsFields {
  readonly name: string;
  readonly host: string;
  readonly port: number;
  readonly called_ae: string;
  readonly calling_ae: string;
  readonly listen_port: number | null;
  readonly listen_host: string;
  readonly tls: boolean;
  readonly url: string;
  readonly user: string;
  readonly ca_file: string;
}

/** Save a connection; the answer is `pacs_connections`. */
export interface SavePacsMessage {
  readonly type: "save_pacs";
  readonly connection: PacsFields;
  readonly password: string | null;
  readonly replaces?: string | null;
}

/** Delete a saved connection and its password; the answer is `pacs_connections`. */
export interface RemovePacsMessage {
  readonly type: "remove_pacs";
  readonly name: string;
}

/** Test a saved connection step by step, by a job; the answer is `pacs_test`. */
export interface TestPacsMessage {
  readonly type: "test_pacs";
  readonly name: string;
}

/** Search studies by patient or date, by a job; the answer is `pacs_studies`. */
export interface SearchPacsMessage {
  readonly type: "search_pacs";
  readonly name: string;
  readonly patient_name: string;
  readonly patient_id: string;
  readonly date: string;
}

/** Request the series of a study, by a job; the answers are `pacs_series`, then a `pacs_preview` for each. */
export interface AskPacsSeriesMessage {
  readonly type: "ask_pacs_series";
  readonly name: string;
  readonly study_uid: string;
}

/** Retrieve a series and open it as a case, by a job; an interrupted retrieval continues. */
export interface GetPacsSeriesMessage {
  readonly type: "get_pacs_series";
  readonly name: string;
  readonly study_uid: string;
  readonly series_uid: string;
}

/** Stop test, search and previews, because the window has closed their list; a retrieval continues. */
export interface StopPacsMessage {
  readonly type: "stop_pacs";
}

/** Delete all series that were retrieved from a PACS from this machine; the answer is `pacs_connections`. */
export interface EmptyPacsMessage {
  readonly type: "empty_pacs";
}

/** Store files of a target's plan in a PACS, by a job; the answer is `pacs_sent`.

    The files contain name and number of the CT's patient, so that the PACS files them with the CT. */
export interface SendPlanToPacsMessage {
  readonly type: "send_plan_to_pacs";
  readonly name: string;
  readonly target_id: string;
  readonly files: readonly ("pdf" | "seg" | "sr")[];
}

/** A flight that was recorded into the case. */
export interface FlightInfo {
  readonly number: number;
  readonly name: string;
  readonly words: string;
  readonly begun_s: number | null;
  readonly length_s: number;
  readonly is_expert: boolean;
  readonly state: "complete" | "cut-off" | "recording";
}

/** Recordings of the case in order; sent after each change. */
export interface FlightsMessage {
  readonly type: "flights";
  readonly flights: readonly FlightInfo[];
}

/** A device that has sent samples; its position is filtered. */
export interface DeviceInfo {
  readonly device: string;
  readonly position_mm: readonly [number, number, number] | null;
  readonly orientation_wxyz: readonly [number, number, number, number] | null;
  readonly buttons: number;
  readonly holds: boolean;
  readonly registered: boolean;
  readonly residual_mm: number | null;
  readonly latency_ms: number;
  readonly num_used: number;
  readonly num_ignored: number;
  readonly ignored_words: string;
  readonly axes: readonly number[];
}

/** A connection between this machine and a device. */
export interface DeviceSource {
  readonly address: string;
  readonly title: string;
  readonly state: "connecting" | "live" | "lost" | "stopped";
  readonly words: string;
  readonly rate_hz: number;
  readonly num_bad: number;
}

/** The page for a phone while it is open to the network; it moves the tip. */
export interface PhoneInfo {
  readonly url: string;
  readonly address: string;
  readonly sha256: string;
  readonly num_refused: number;
  readonly qr: readonly string[];
  readonly connected: boolean;
  readonly rate_hz: number;
  readonly num_bad: number;
  readonly bad_words: string;
}

/** Input devices, how they move the tip, and what is recorded. */
export interface DevicesMessage {
  readonly type: "devices";
  readonly control: "absolute" | "path" | "relative";
  readonly filter_latency_ms: number;
  readonly controls: DeviceControls;
  readonly devices: readonly DeviceInfo[];
  readonly sources: readonly DeviceSource[];
  readonly serial_ports: readonly string[];
  readonly serial_problem: string | null;
  readonly published_port: number | null;
  readonly recording: string | null;
  readonly phone: PhoneInfo | null;
  readonly phone_problem: string | null;
}

/** Report that the pen's button marked the start of a path that needs no airways (`arm_pen`, `add_target`). */
export interface StartMarkedMessage {
  readonly type: "start_marked";
  readonly lps: readonly [number, number, number];
}

/** State of the tracked pen that moves the tip, and the point that its button marks; sent after each change. */
export interface PenMessage {
  readonly type: "pen";
  readonly device: string | null;
  readonly tracked: boolean;
  readonly lps: readonly [number, number, number] | null;
  readonly off_mm: number | null;
  readonly off_deg: number | null;
}

/** Answer to `target_mark`. */
export interface TargetMarkMessage {
  readonly type: "target_mark";
  readonly request_id: number;
  readonly lps: readonly [number, number, number];
  readonly sentences: readonly string[];
  readonly warns: boolean;
}

/** A layer of the lung map; images show it as outlines (`PictureLayer`). */
export interface MappedLayer {
  readonly layer: "fissures" | "lobes" | "reach" | "vessels";
  readonly words: string;
  readonly limits: readonly string[];
  readonly parts: readonly string[];
}

/** A branch of a vessel, for the view from outside. */
export interface VesselLine {
  readonly points_lps: readonly (readonly [number, number, number])[];
  readonly diameter_mm: number;
  readonly sure: boolean;
}

/** Place to search for a lymph node station with EBUS, derived from the airways alone. */
export interface Station {
  readonly station: string;
  readonly words: string;
  readonly point_lps: readonly [number, number, number] | null;
  readonly direction_lps: readonly [number, number, number] | null;
  readonly borders: string;
  readonly doubts: readonly string[];
}

/** The lung map: vessels, fissures, lobes, reach and lymph node stations; sent after each change. */
export interface LungsMessage {
  readonly type: "lungs";
  readonly standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly reach_standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly layers: readonly MappedLayer[];
  readonly vessels: readonly VesselLine[];
  readonly stations: readonly Station[];
  readonly station_limits: string;
  readonly problems: readonly string[];
  readonly outdated: boolean;
}

/** The boundary of a target as a triangle mesh for drawing. */
export interface TargetSurface {
  readonly vertices_lps: readonly (readonly [number, number, number])[];
  readonly triangles: readonly number[];
}

/** Instruments that shall reach a target, and conditions that reduce the score of a route. */
export interface PlanOptions {
  readonly scope: string;
  readonly tool: string;
  readonly vessel_margin_mm: number;
  readonly moved_mm: number | null;
  readonly movement: MeasuredMovement | null;
  readonly entry_mm: number | null;
  readonly carina_depth_mm: number | null;
  readonly place: ChosenPlace | null;
}

/** The origin of the distances along a route. */
export interface RouteOrigin {
  readonly kind: "axes" | "ridge" | "root" | "route";
  readonly along_mm: number;
}

/** A segment of a needle's path inside one tissue; positions are distances in mm from the scope's tip. */
export interface NeedleTissue {
  readonly tissue: string;
  readonly from_mm: number;
  readonly to_mm: number;
}

/** The path of the needle from the scope's tip into the target; `leg` of a route in plan.json has the same keys. */
export interface NeedleLeg {
  readonly tip_lps: readonly [number, number, number];
  readonly aim_lps: readonly [number, number, number];
  readonly to_target_mm: number;
  readonly angle_deg: number;
  readonly crossed: readonly NeedleTissue[];
  readonly in_target_mm: number;
  readonly vessel_mm: number | null;
  readonly hit_share: number | null;
  readonly hit_share_moved: number | null;
}

/** Published predictors of a failed navigation; `predictors` of a route in plan.json has the same keys. */
export interface FailurePredictors {
  readonly bifurcation_deg: number | null;
  readonly least_mm: number;
  readonly least_error_mm: number;
  readonly least_by: "ball" | "sections";
  readonly curvature_per_mm: number | null;
  readonly note: string;
}

/** A planned route to a target, with its measurements and its score; a route in plan.json has the same keys. */
export interface RouteOffer {
  readonly key: string;
  readonly branch_id: number;
  readonly branch_name: string;
  readonly origin: RouteOrigin;
  readonly from_carina_mm: number | null;
  readonly narrowest_mm: number;
  readonly narrowest_error_mm: number;
  readonly narrowest_at_mm: number;
  readonly narrowest_by: "ball" | "sections";
  readonly narrowest_why: string | null;
  readonly fit: "does not fit" | "fits" | "may fit";
  readonly outlook: string;
  readonly limits: readonly string[];
  readonly leg: NeedleLeg;
  readonly score: number;
  readonly doubts: readonly string[];
  readonly predictors: FailurePredictors | null;
}

/** A lymph node station that a route passes or that is next to its target, by the landmark of its examination. */
export interface StationOnRoute {
  readonly station: string;
  readonly head: string;
  readonly facing: string;
  readonly point_lps: readonly [number, number, number];
  readonly direction_lps: readonly [number, number, number];
  readonly borders: string;
  readonly doubts: readonly string[];
}

/** A lesion that is a target, and the routes to it. */
export interface TargetPlan {
  readonly target_id: string;
  readonly centre_lps: readonly [number, number, number];
  readonly size: string;
  readonly where: string | null;
  readonly long_mm: number;
  readonly num_aims: number;
  readonly surface: TargetSurface;
  readonly options: PlanOptions;
  readonly moved_mm: number | null;
  readonly movement: string | null;
  readonly bronchus_sign: string | null;
  readonly reasons: readonly (readonly [string, string, "caution" | "stop"])[];
  readonly routes: readonly RouteOffer[];
  readonly problem: string | null;
  readonly notes: readonly string[];
  readonly doubts: readonly (readonly [string, string])[];
  readonly unconfirmed: readonly string[];
  readonly chosen: number | null;
  readonly stations: readonly StationOnRoute[];
}

/** One check of an instrument on a route, with its answer. */
export interface ScopeCheck {
  readonly name: string;
  readonly answer: "no" | "perhaps" | "unknown" | "yes";
  readonly words: string;
  readonly basis: string;
}

/** Verdict on one instrument for the chosen route, with its checks; a verdict in plan.json has the same keys. */
export interface ScopeVerdict {
  readonly scope: string;
  readonly tool: string;
  readonly title: string;
  readonly route: string;
  readonly outcome: string;
  readonly words: string;
  readonly share: number | null;
  readonly would: string | null;
  readonly reached_mm: number | null;
  readonly checks: readonly ScopeCheck[];
  readonly was_driven: boolean;
}

/** An opening at a turn of the chosen route. */
export interface TurnOpening {
  readonly branch_id: number;
  readonly middle_lps: readonly [number, number, number] | null;
  readonly in_view: boolean;
  readonly straight_ahead: boolean;
  readonly ahead_deg: number;
}

/** A turn at a fork of the chosen route. */
export interface PlannedTurn {
  readonly head: string;
  readonly facing: string;
  readonly from_carina_mm: number | null;
  readonly from_fork_mm: number;
  readonly depth_estimate_mm: number | null;
  readonly doubts: readonly string[];
  readonly fork_branch_id: number;
  readonly seen_from_lps: readonly [number, number, number] | null;
  readonly openings: readonly TurnOpening[];
  readonly hour_doubt: string | null;
  readonly dots_lps: readonly (readonly [number, number, number])[];
}

/** Verdict on one pair of the best routes and all instruments; a pair in plan.json has the same keys. */
export interface RoutePair {
  readonly scope: string;
  readonly tool: string;
  readonly title: string;
  readonly route: string;
  readonly outcome: string;
  readonly words: string;
  readonly share: number | null;
  readonly would: string | null;
  readonly available: boolean;
}

/** A position of a C-arm for a route; an angle of `c_arm` in plan.json has the same keys. */
export interface CArmPosition {
  readonly primary_deg: number;
  readonly secondary_deg: number;
  readonly name: string;
  readonly words: string;
}

/** Positions of a C-arm for one route, the best one first; `c_arm` in plan.json has the same keys. */
export interface CArmPositions {
  readonly angles: readonly CArmPosition[];
  readonly why: string | null;
  readonly limits: string;
  readonly notes: readonly string[];
}

/** Row of the comparison of targets by the first route of each; a row of `--compare --json` has the same keys. */
export interface PlannedTargetRow {
  readonly target_id: string;
  readonly name: string;
  readonly outlook: string;
  readonly route: string | null;
  readonly hit_share: number | null;
  readonly narrowest_mm: number | null;
  readonly narrowest_error_mm: number | null;
  readonly from_carina_mm: number | null;
  readonly to_target_mm: number | null;
  readonly vessel_mm: number | null;
  readonly doubts: readonly string[];
}

/** A target that cannot be compared, because it has no plan. */
export interface UnplannedTarget {
  readonly target_id: string;
  readonly why: string;
}

/** The planned targets of the case in one order, the best first. */
export interface TargetComparison {
  readonly order: string;
  readonly targets: readonly PlannedTargetRow[];
  readonly unplanned: readonly UnplannedTarget[];
}

/** The plans of all lesions; sent after each change. */
export interface PlansMessage {
  readonly type: "plans";
  readonly targets: readonly TargetPlan[];
  readonly standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly verdicts: readonly ScopeVerdict[];
  readonly verdicts_standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly tools: readonly (readonly [string, string])[];
  readonly turns: readonly PlannedTurn[];
  readonly parking: readonly [string, string] | null;
  readonly park_from_carina_mm: number | null;
  readonly park_depth_estimate_mm: number | null;
  readonly dicom_problem: string | null;
  readonly pairs: readonly RoutePair[];
  readonly pairs_standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly available: readonly string[] | null;
  readonly carm: CArmPositions | null;
  readonly carm_standing: "failed" | "had" | "making" | "stopped" | "unwanted";
  readonly comparison: TargetComparison | null;
  readonly station_note: string;
}

/** Answer to the client's `hello`. */
export interface ServerHelloMessage {
  readonly type: "hello";
  readonly wire_version: number;
  readonly carina_version: string;
  readonly watches: boolean;
  readonly window: number;
  readonly at_machine: boolean;
}

/** An entry of the case list: a case that was opened before, without the name of its CT file. */
export interface RecentCase {
  readonly recent_id: string;
  readonly date: string;
  readonly title: string;
  readonly used_s: number | null;
  readonly begun_s: number | null;
  readonly num_changes: number | null;
  readonly num_nodules: number | null;
  readonly num_bytes: number;
  readonly picture: string | null;
  readonly opens: boolean;
  readonly scanned_on: string | null;
  readonly named: boolean;
}

/** Source and licence of a case; `str()` of a citation is one line of text. */
export interface Citation {
  readonly authors: string;
  readonly year: number;
  readonly title: string;
  readonly publisher: string;
  readonly doi: string;
  readonly licence: string;
  readonly changes: string;
  readonly collection: string;
}

/** A demonstration case that is part of Carina. */
export interface Demo {
  readonly name: "patient" | "phantom";
  readonly title: string;
  readonly words: string;
  readonly citation: Citation | null;
}

/** An instrument of the library; a field is null if its value is not known. */
export interface Scope {
  readonly name: string;
  readonly title: string;
  readonly tip_mm: number;
  readonly fit_mm: number;
  readonly channel_mm: number | null;
  readonly fov_deg: number | null;
  readonly view_up_deg: number;
}

/** Data stored on the disk besides the cases of the case list. */
export interface Storage {
  readonly num_cts: number;
  readonly ct_bytes: number;
  readonly keeps_cts: "never" | "off" | "on";
  readonly forgotten: readonly RecentCase[];
}

/** Content of the start page: cases, demonstration cases, instruments and storage. */
export interface StartMessage {
  readonly type: "start";
  readonly notice_accepted: boolean;
  readonly recent: readonly RecentCase[];
  readonly demos: readonly Demo[];
  readonly scopes: readonly Scope[];
  readonly storage: Storage | null;
  readonly no_video: string | null;
  readonly hints_read: boolean;
}

/** Picture of a series of the open CT's folder, or of a folder that is being opened: its middle slice. */
export interface SeriesPictureMessage {
  readonly type: "series_picture";
  readonly key: string;
  readonly picture: string;
  readonly list_id: string | null;
}

/** A series in the folder of the open series: another one, or the open series itself. */
export interface OtherSeries {
  readonly key: string;
  readonly modality: string;
  readonly description: string;
  readonly num_slices: number;
  readonly refused: string | null;
  readonly slice_distance_mm: number | null;
  readonly thickness_mm: number | null;
  readonly kernel: string;
  readonly phase: string;
  readonly acquired_on: string | null;
  readonly likeliest: string;
}

/** An axial slice of a CT that is being opened, with the patient's right on the left of the picture. */
export interface OpeningSlice {
  readonly picture: string;
  readonly number: number;
  readonly num_slices: number;
  readonly height_lps_mm: number;
  readonly width_mm: number;
  readonly height_mm: number;
  readonly is_hu: boolean;
}

/** Preview of the CT that a job is opening; `job_id` is null at the end, after an error and after a cancel. */
export interface OpeningMessage {
  readonly type: "opening";
  readonly job_id: string | null;
  readonly list_id: string | null;
  readonly series: readonly OtherSeries[];
  readonly chosen: string | null;
  readonly num_patients: number;
  readonly slice: OpeningSlice | null;
}

/** A note to the user about the case, with a code that does not change between versions. */
export interface CaseNote {
  readonly code: string;
  readonly words: string;
  readonly badge: boolean;
}

/** A feature that this volume does not support, and the reason. */
export interface FeatureOff {
  readonly what: string;
  readonly why: string;
}

/** A property of the CT that decides which airways can be seen in it, such as noise or coverage. */
export interface CtPropertyInfo {
  readonly name: string;
  readonly text: string;
  readonly limits: boolean;
}

/** Statement on the CT: its properties, and the generation up to which airways can be trusted. */
export interface CtStatement {
  readonly properties: readonly CtPropertyInfo[];
  readonly trusted_generation: number;
  readonly trusted_words: string;
}

/** The open volume and its properties. */
export interface CaseInfo {
  readonly title: string;
  readonly format: string;
  readonly is_hu: boolean;
  readonly not_hu_reason: string | null;
  readonly shape_zyx: readonly [number, number, number];
  readonly spacing_mm: readonly [number, number, number];
  readonly lps_from_ijk: readonly number[];
  readonly value_range: readonly [number, number];
  readonly warnings: readonly string[];
  readonly notes: readonly CaseNote[];
  readonly quality: readonly string[];
  readonly other_series: readonly OtherSeries[];
  readonly citation: Citation | null;
  readonly off: readonly FeatureOff[];
  readonly number: number;
  readonly interpolated_slices: readonly number[];
  readonly tilt_deg: number | null;
  readonly slice_places: readonly number[];
  readonly statement: CtStatement | null;
  readonly series: OtherSeries | null;
  readonly ct_name: string | null;
}

/** Settings of the airway view that the user chose and that undo restores: instrument, outline and field of view. */
export interface Look {
  readonly scope: string | null;
  readonly outline: "none" | "octagon" | "round";
  readonly fov_deg: number;
  readonly operator: "facing" | "head";
}

/** Window and level of all slice views, in HU, or in stored values if the volume is not in HU. */
export interface GreyWindow {
  readonly width_hu: number;
  readonly level_hu: number;
}

/** Thick slice that shows the largest, smallest or mean value over its thickness.

    `min` shows airways; 0 mm is a thin slice. */
export interface Slab {
  readonly thickness_mm: number;
  readonly kind: "max" | "mean" | "min";
}

/** Zoom and centre of a planar view: scale of a slice, or width of the cut-plane; null shows the whole area. */
export interface FlatPlace {
  readonly mm_per_px: number | null;
  readonly extent_mm: number | null;
  readonly centre_lps: readonly [number, number, number] | null;
}

/** Camera of an external view: azimuth 0 looks from anterior; null as distance fits the view to its content. */
export interface Orbit {
  readonly azimuth_deg: number;
  readonly elevation_deg: number;
  readonly distance_mm: number | null;
}

/** Angles of the radiograph's C-arm (LAO and cranial above 0), tone, and scale at the centre; null fits. */
export interface Carm {
  readonly primary_deg: number;
  readonly secondary_deg: number;
  readonly mm_per_px: number | null;
  readonly tone: "fluoroscopy" | "radiograph";
}

/** Angle of the cutting plane and scale of the views along the route; null as scale fits the whole route. */
export interface Reformation {
  readonly turn_deg: number;
  readonly mm_per_px: number | null;
}

/** Display settings of a case (window, slab, crosshair, zoom, orbits), which undo does not change. */
export interface Sight {
  readonly crosshair_lps: readonly [number, number, number] | null;
  readonly window: GreyWindow | null;
  readonly slab: Slab;
  readonly zoom: Readonly<Record<string, FlatPlace>>;
  readonly orbits: Readonly<Record<string, Orbit>>;
  readonly carm: Carm;
  readonly reformation: Reformation;
  readonly shading: boolean;
  readonly texture: boolean;
  readonly method: "brute" | "leap";
}

/** A target with the requested point, the point that is used, and the path to that point. */
export interface Target {
  readonly target_id: string;
  readonly name: string;
  readonly lps: readonly [number, number, number];
  readonly used_lps: readonly [number, number, number] | null;
  readonly snapped_mm: number | null;
  readonly length_mm: number | null;
  readonly problem: string | null;
  readonly outside_mm: number | null;
  readonly crossings_mm: readonly number[] | null;
  readonly value_range: readonly [number, number] | null;
  readonly note: string;
  readonly priority: number;
  readonly has_size: boolean;
  readonly from_carina_mm: number | null;
  readonly cost: "lumen" | "paper" | "walls";
  readonly root_lps: readonly [number, number, number] | null;
}

/** A structure in an imported mask. */
export interface MaskLabel {
  readonly number: number;
  readonly name: string | null;
  readonly volume_ml: number;
}

/** Question to the user about an imported mask before it can define the airways; answered by `answer_mask`. */
export interface MaskQuestion {
  readonly title: string;
  readonly problem: "grid" | "label";
  readonly labels: readonly MaskLabel[];
  readonly suggested: number | null;
  readonly expected: string | null;
  readonly found: string | null;
  readonly share_inside: number | null;
}

/** State of the stored case and of its named file on the disk; times are seconds since 1970. */
export interface SavingInfo {
  readonly keeps: boolean;
  readonly saved_s: number | null;
  readonly begun_s: number | null;
  readonly problem: string | null;
  readonly copied_s: number | null;
  readonly copy_name: string | null;
  readonly copy_folder: string | null;
  readonly copy_problem: string | null;
  readonly copy_conflict: "changed" | "missing" | "not-a-case" | "open-elsewhere" | "other-case" | null;
  readonly beside: string | null;
  readonly suggested: string | null;
  readonly title: string | null;
  readonly continued_s: number | null;
  readonly continued_changes: number;
}

/** Settings of the simulated breathing. */
export interface BreathingInfo {
  readonly on: boolean;
  readonly movement_mm: number;
  readonly period_s: number;
}

/** State of the session, except for pose, tree, route and the other parts that have their own messages. */
export interface StateMessage {
  readonly type: "state";
  readonly case: CaseInfo | null;
  readonly stage: "empty" | "opening" | "ready";
  readonly airways: "failed" | "finding" | "found" | "none" | "waiting";
  readonly airways_words: string | null;
  readonly mode: "free" | "path" | "scope";
  readonly look: Look;
  readonly sight: Sight;
  readonly transfer: string;
  readonly transfer_document: Readonly<Record<string, unknown>> | null;
  readonly transfer_presets: readonly string[];
  readonly targets: readonly Target[];
  readonly route_id: string | null;
  readonly can_undo: string | null;
  readonly can_redo: string | null;
  readonly root_lps: readonly [number, number, number] | null;
  readonly lumen_threshold: number | null;
  readonly frame_rate_hz: number;
  readonly airways_from: "mask" | "search" | null;
  readonly mask_question: MaskQuestion | null;
  readonly badges: readonly CaseNote[];
  readonly saving: SavingInfo;
  readonly breathing: BreathingInfo;
}

/** A step of the undo history. */
export interface HistoryStep {
  readonly label: string;
  readonly at_s: number;
}

/** Undo history, the oldest step first; sent after each change. */
export interface HistoryMessage {
  readonly type: "history";
  readonly steps: readonly HistoryStep[];
  readonly step: number;
}

/** Part of a route inside one branch, as positions in mm along the route. */
export interface RouteSpan {
  readonly branch_id: number;
  readonly name: string | null;
  readonly generation: number;
  readonly from_mm: number;
  readonly to_mm: number;
  readonly kind: "bridge" | "manual" | "tracked";
}

/** The last leg of a planned route: the straight line of the needle from the scope's tip into the target. */
export interface NeedleLine {
  readonly ends_lps: readonly [readonly [number, number, number], readonly [number, number, number]];
  readonly to_target_mm: number;
}

/** Whether an instrument passes the narrowest measured place of a route. */
export interface ScopeFit {
  readonly scope: string;
  readonly fit: "does not fit" | "fits" | "may fit";
}

/** The current route; its point lists are parallel and go from the root to the tip. */
export interface RouteInfo {
  readonly length_mm: number;
  readonly drawn_mm: number;
  readonly bridge_mm: number;
  readonly route_id: string;
  readonly title: string;
  readonly target_id: string | null;
  readonly branch_id: number | null;
  readonly points_lps: readonly (readonly [number, number, number])[];
  readonly cumulative_mm: readonly number[];
  readonly generation: readonly number[];
  readonly radius_mm: readonly number[];
  readonly wall_mm: readonly number[];
  readonly forks_mm: readonly number[];
  readonly lookouts_mm: readonly number[];
  readonly spans: readonly RouteSpan[];
  readonly lumen_known: boolean;
  readonly needle: NeedleLine | null;
  readonly narrowest_mm: number | null;
  readonly narrowest_error_mm: number | null;
  readonly narrowest_at_mm: number | null;
  readonly scope_fits: readonly ScopeFit[];
  readonly origin: RouteOrigin;
  readonly centreline_mm: readonly number[];
}

/** The current route; sent after each change. */
export interface RouteMessage {
  readonly type: "route";
  readonly route: RouteInfo | null;
}

/** A scope whose position the lumen limits: controls and contacts. */
export interface HeldScope {
  readonly insertion_mm: number;
  readonly roll_rad: number;
  readonly flexion_rad: number;
  readonly red_out: number;
  readonly limit: "entry" | "flexion" | "length" | "narrow" | "none" | "wall";
  readonly needs_mm: number | null;
  readonly tip_mm: number | null;
  readonly contact_mm: number | null;
  readonly num_contacts: number;
  readonly contact_s: number;
}

/** A recorded flight that is being replayed, and the time in it. */
export interface FlightPlace {
  readonly number: number;
  readonly time_s: number;
}

/** The newest pose; each image names its pose by `pose_id`. */
export interface PoseMessage {
  readonly type: "pose";
  readonly pose_id: number;
  readonly lps_from_camera: readonly number[];
  readonly mode: "free" | "path" | "scope";
  readonly path_mm: number | null;
  readonly branch_id: number | null;
  readonly branch_name: string | null;
  readonly generation: number | null;
  readonly lumen_mm: number | null;
  readonly inside: boolean;
  readonly scope: HeldScope | null;
  readonly key_frames_s: number | null;
  readonly flight: FlightPlace | null;
  readonly by_device: boolean;
  readonly back_to_route_mm: number | null;
}

/** Progress of a job; the fraction and the remaining time are null if they are not known. */
export interface ProgressMessage {
  readonly type: "progress";
  readonly job_id: string;
  readonly title: string;
  readonly what: string;
  readonly fraction: number | null;
  readonly seconds_left: number | null;
}

/** Report that a job has ended; after a failure the server also sends `error`. */
export interface DoneMessage {
  readonly type: "done";
  readonly job_id: string;
  readonly outcome: "cancelled" | "done" | "failed";
}

/** Report that an operation failed; the window shows it until the user dismisses it. */
export interface ErrorMessage {
  readonly type: "error";
  readonly code: string;
  readonly message: string;
  readonly action: string | null;
}

/** A short message for the user that reports no error. */
export interface NoticeMessage {
  readonly type: "notice";
  readonly message: string;
}

/** An observer of the case. */
export interface Watcher {
  readonly number: number;
  readonly address: string;
  readonly since_s: number;
}

/** The observer page, through which people on the local network see the images of the patient. */
export interface WatchPage {
  readonly url: string;
  readonly address: string;
  readonly sha256: string;
  readonly num_refused: number;
  readonly watchers: readonly Watcher[];
  readonly learners: boolean;
}

/** State of the observer page; never sent to observers. */
export interface WatchingMessage {
  readonly type: "watching";
  readonly page: WatchPage | null;
  readonly problem: string | null;
}

/** Processor of airway views that the user has chosen; never sent to observers. */
export interface ProcessorChoiceMessage {
  readonly type: "processor_choice";
  readonly choice: "auto" | "cpu" | "gpu";
  readonly is_forced: boolean;
  readonly has_graphics: boolean;
  readonly problem: string | null;
}

/** Number of commands of this window that were executed or refused; sent after the state that they changed. */
export interface HandledMessage {
  readonly type: "handled";
  readonly number: number;
}

/** Answer to `probe`; the server answers only the newest request. */
export interface ValueMessage {
  readonly type: "value";
  readonly lps: readonly [number, number, number];
  readonly voxel_value: number | null;
}

/** Answer to `pick`: the wall under a pixel of an airway image; all fields are null if the ray hits no wall. */
export interface PickedMessage {
  readonly type: "picked";
  readonly pick_id: number;
  readonly lps: readonly [number, number, number] | null;
  readonly depth_mm: number | null;
  readonly voxel_value: number | null;
  readonly branch_id: number | null;
  readonly branch_name: string | null;
  readonly generation: number | null;
}

/** Performance of the image stream; sent twice a second while the tip moves, and once after it stops. */
export interface StatusMessage {
  readonly type: "status";
  readonly threads: number;
  readonly simd: string;
  readonly fps: number;
  readonly render_ms: number;
  readonly age_ms: number;
  readonly method: string;
}

/** State of one machine that renders pictures together with others. */
export interface MemberStatus {
  readonly threads: number;
  readonly simd: string;
  readonly host: string;
  readonly name: string;
  readonly state: "away" | "late" | "loading" | "ready";
  readonly share: number;
  readonly latency_ms: number | null;
  readonly num_late: number;
  readonly num_strips: number;
}

/** State of the render cluster; sent once a second if there is a cluster. */
export interface ClusterMessage {
  readonly type: "cluster";
  readonly address: string;
  readonly members: readonly MemberStatus[];
  readonly alone: boolean;
  readonly mixed: boolean;
  readonly fps: number;
  readonly frame_ms: number | null;
}

/** A line of a previewed or refused edit. */
export interface EditLine {
  readonly points_lps: readonly (readonly [number, number, number])[];
  readonly doubtful: readonly boolean[];
  readonly drawn: readonly boolean[];
}

/** The place in the tree at which a new branch begins. */
export interface BranchOrigin {
  readonly branch: string;
  readonly extends: boolean;
}

/** Answer to `preview_edit`: the exact lines that the edit would create, or the reason why it is not possible. */
export interface EditPreviewMessage {
  readonly type: "edit_preview";
  readonly request_id: number;
  readonly tool: "add-branch" | "bridge" | "move-fork";
  readonly lps: readonly [number, number, number] | null;
  readonly lines: readonly EditLine[];
  readonly length_mm: number | null;
  readonly doubtful_mm: number | null;
  readonly has_evidence: boolean;
  readonly problem: string | null;
  readonly origin: BranchOrigin | null;
  readonly renamed: readonly string[] | null;
}

/** Report that `add-branch` was refused, because the CT does not show an airway wall along the whole path.

    The server sends this message instead of `error`. The same edit with `even_without_evidence` draws exactly this
    path. */
export interface NoEvidenceMessage {
  readonly type: "no_evidence";
  readonly job_id: string;
  readonly code: "track.no-evidence";
  readonly message: string;
  readonly lps: readonly [number, number, number];
  readonly line: EditLine;
  readonly length_mm: number;
  readonly doubtful_mm: number;
}

/** A key frame: a pose through which the flight passes. */
export interface ShownKeyFrame {
  readonly key_id: string;
  readonly name: string;
  readonly own_name: boolean;
  readonly branch_id: number | null;
  readonly speed_mm_s: number | null;
  readonly time_s: number;
  readonly leg_mm: number | null;
  readonly through_airways: boolean;
}

/** The key frames; sent after each change. */
export interface KeyFramesMessage {
  readonly type: "key_frames";
  readonly speed_mm_s: number;
  readonly through: "airways" | "space";
  readonly frames: readonly ShownKeyFrame[];
  readonly duration_s: number;
  readonly problem: string | null;
}

/** The saved connections, and the retrieved series on this machine. */
export interface PacsConnectionsMessage {
  readonly type: "pacs_connections";
  readonly connections: readonly PacsFields[];
  readonly num_retrieved: number;
  readonly retrieved_bytes: number;
  readonly folder: string;
  readonly problem: string | null;
}

/** One step of a connection test. */
export interface PacsStep {
  readonly name: string;
  readonly passed: boolean;
  readonly finding: string;
}

/** Result of a connection test. */
export interface PacsTestMessage {
  readonly type: "pacs_test";
  readonly name: string;
  readonly passed: boolean;
  readonly steps: readonly PacsStep[];
}

/** A study of a search result, with the name of its patient for the user of this machine. */
export interface PacsStudyEntry {
  readonly study_uid: string;
  readonly patient_name: string;
  readonly patient_id: string;
  readonly date: string;
  readonly description: string;
  readonly modalities: string;
  readonly num_series: number | null;
}

/** Result of a search, the newest study first. */
export interface PacsStudiesMessage {
  readonly type: "pacs_studies";
  readonly name: string;
  readonly studies: readonly PacsStudyEntry[];
  readonly has_more: boolean;
}

/** A series of a study in a PACS. */
export interface PacsSeriesEntry {
  readonly series_uid: string;
  readonly modality: string;
  readonly description: string;
  readonly number: number | null;
  readonly num_images: number | null;
}

/** Series of a study. */
export interface PacsSeriesMessage {
  readonly type: "pacs_series";
  readonly name: string;
  readonly study_uid: string;
  readonly series: readonly PacsSeriesEntry[];
  readonly preselected: string | null;
  readonly reason: string;
}

/** Properties and picture of a series, read from its middle image. */
export interface PacsPreviewMessage {
  readonly type: "pacs_preview";
  readonly series_uid: string;
  readonly slice_mm: number | null;
  readonly kernel: string;
  readonly phase: string;
  readonly scanned_on: string | null;
  readonly picture: string | null;
}

/** Files of a plan that the PACS has stored, and those that it refused. */
export interface PacsSentMessage {
  readonly type: "pacs_sent";
  readonly name: string;
  readonly target_id: string;
  readonly num_stored: number;
  readonly refused: readonly string[];
}

/** Failure of a request, with its reason and what to do. */
export interface PacsProblemMessage {
  readonly type: "pacs_problem";
  readonly task: "get" | "search" | "send" | "series" | "settings" | "test";
  readonly code: string;
  readonly problem: string;
  readonly target_id: string | null;
}

/** A task of the training. */
export interface TaskInfo {
  readonly name: string;
  readonly title: string;
  readonly level: "advanced" | "beginner" | "intermediate";
  readonly time_limit_s: number | null;
  readonly names_shown: boolean;
  readonly tree_shown: boolean;
  readonly ghost_shown: boolean;
  readonly problem: string | null;
  readonly is_own: boolean;
}

/** The attempt at a task that is being flown. */
export interface RunningTask {
  readonly task: string;
  readonly flight: number;
  readonly elapsed_s: number;
  readonly num_steps: number;
  readonly steps_done: readonly string[];
  readonly next_step: string | null;
  readonly arrow_branches: readonly number[];
  readonly message: string | null;
  readonly is_warning: boolean;
  readonly paused: boolean;
  readonly learner: string | null;
}

/** A running quiz: its present question, and the answers so far. */
export interface QuizInfo {
  readonly kind: "name-opening" | "slices" | "where-are-you";
  readonly number: number;
  readonly num_questions: number;
  readonly choices: readonly string[];
  readonly lps_from_tip: readonly number[];
  readonly num_right: number;
  readonly given: string | null;
  readonly answer: string | null;
  readonly is_over: boolean;
}

/** The published scores of an attempt; docs/training.md defines each of them and names its source. */
export interface PublishedScores {
  readonly num_seen: number;
  readonly num_progressions: number;
  readonly time_s: number;
  readonly time_per_segment_s: number | null;
  readonly num_revisited: number;
}

/** Measures of an attempt for which no threshold is published. */
export interface UnmarkedMeasures {
  readonly path_mm: number;
  readonly smoothness: number | null;
  readonly num_contacts: number;
  readonly contact_s: number;
  readonly red_out_s: number;
  readonly middle_share: number;
}

/** A moment of a scored flight, to be replayed. */
export interface ScoreMoment {
  readonly time_s: number;
  readonly words: string;
}

/** When and how a segment of the case was seen in a flight. */
export interface SegmentVisit {
  readonly name: string;
  readonly branch_ids: readonly number[];
  readonly seen_s: number | null;
  readonly entered: boolean;
}

/** Event on the timeline of a flight. */
export interface TimelineMark {
  readonly at_s: number;
  readonly kind: "contact" | "revisit" | "seen" | "wrong";
  readonly name: string;
}

/** Scores of a recorded flight. */
export interface FlightScore {
  readonly flight: number;
  readonly task: string;
  readonly task_title: string;
  readonly is_inspection: boolean;
  readonly completed: boolean;
  readonly num_steps_done: number;
  readonly num_steps: number;
  readonly num_wrong: number;
  readonly published: PublishedScores;
  readonly unmarked: UnmarkedMeasures;
  readonly seen: readonly string[];
  readonly not_seen: readonly string[];
  readonly absent: readonly string[];
  readonly doubts: readonly string[];
  readonly notes: readonly string[];
  readonly moments: readonly ScoreMoment[];
  readonly segments: readonly SegmentVisit[];
  readonly timeline: readonly TimelineMark[];
  readonly clock_start_s: number;
  readonly clock_end_s: number;
  readonly comparison: readonly string[];
  readonly comparison_moments: readonly ScoreMoment[];
}

/** Published scores of one group on a phantom, with another system; not a pass mark. */
export interface ReferenceScores {
  readonly group: string;
  readonly num_seen: number;
  readonly num_progressions: number;
  readonly time_s: number;
  readonly time_per_segment_s: number;
  readonly source: string;
}

/** A learner of the course. */
export interface LearnerInfo {
  readonly name: string;
  readonly num_attempts: number;
  readonly num_counted: number;
  readonly mastery: boolean | null;
  readonly verdict: string;
}

/** A stored attempt of the chosen learner; the measures are those of `PublishedScores` and `UnmarkedMeasures`. */
export interface CourseAttemptInfo {
  readonly number: number;
  readonly task: string;
  readonly title: string;
  readonly is_inspection: boolean;
  readonly completed: boolean;
  readonly num_steps_done: number;
  readonly num_steps: number;
  readonly counts: boolean;
  readonly reasons: readonly string[];
  readonly published: PublishedScores;
  readonly num_contacts: number;
  readonly middle_share: number;
}

/** The learners of this machine, and the attempts of the chosen one. */
export interface CourseInfo {
  readonly stores: boolean;
  readonly learners: readonly LearnerInfo[];
  readonly chosen: string | null;
  readonly attempts: readonly CourseAttemptInfo[];
  readonly problems: readonly string[];
}

/** A learner in the teacher's view. */
export interface ClassLearner {
  readonly learner: LearnerInfo;
  readonly attempts: readonly CourseAttemptInfo[];
  readonly running: string | null;
}

/** Tasks, the running attempt or quiz, and scores of flights.

    Sent after each change, and each second during an attempt. */
export interface TrainingMessage {
  readonly type: "training";
  readonly tasks: readonly TaskInfo[];
  readonly running: RunningTask | null;
  readonly quiz: QuizInfo | null;
  readonly scores: readonly FlightScore[];
  readonly verdict: string | null;
  readonly references: readonly ReferenceScores[];
  readonly course: CourseInfo;
  readonly task_folder: string | null;
  readonly task_problems: readonly string[];
  readonly classroom: readonly ClassLearner[];
}

/** A branch of a `carina-tree` document. */
export interface TreeBranch {
  readonly id: number;
  readonly parent: number | null;
  readonly children: readonly number[];
  readonly generation: number;
  readonly name: string | null;
  readonly kind: "bridge" | "manual" | "tracked";
  readonly points: readonly (readonly [number, number, number])[];
  readonly radius: readonly number[];
  readonly cost: number | null;
  readonly confidence: number | null;
  readonly name_confidence: number | null;
  readonly name_from: "anatomy" | "person" | null;
  readonly variant: string | null;
  readonly doubtful_mm: number;
}

/** A `carina-tree` document, version 1. */
export interface TreeDocument {
  readonly format: "carina-tree";
  readonly version: 1;
  readonly space: "LPS";
  readonly unit: "mm";
  readonly root: number;
  readonly branches: readonly TreeBranch[];
}

/** The long name of a branch, and the lobe that the branch supplies. */
export interface BranchTitle {
  readonly branch_id: number;
  readonly long: string | null;
  readonly lobe: "LLL" | "LML" | "LUL" | "RLL" | "RML" | "RUL" | null;
}

/** Measurements of a branch without its junctions.

    Lumens are diameters in mm. The true value differs by at most the error in 95 of 100 cases. */
export interface BranchMeasures {
  readonly branch_id: number;
  readonly length_mm: number;
  readonly by_earlier_method: boolean;
  readonly lumen_mm: number | null;
  readonly lumen_error_mm: number | null;
  readonly min_lumen_mm: number | null;
  readonly min_lumen_error_mm: number | null;
  readonly min_at_mm: number | null;
  readonly max_lumen_mm: number | null;
  readonly max_lumen_error_mm: number | null;
  readonly wall_mm: number | null;
  readonly wall_error_mm: number | null;
  readonly taper: number | null;
  readonly angle_deg: number | null;
  readonly stenosis_percent: number | null;
  readonly stenosis_error_percent: number | null;
  readonly stenosis_at_mm: number | null;
}

/** A place where the automatic airways end too early, with its description. */
export interface UncertainPlace {
  readonly lps: readonly [number, number, number];
  readonly branch_id: number | null;
  readonly kind: "blocked" | "faint" | "filled" | "fine" | "leak" | "lost" | "stump" | "volume";
  readonly width_mm: number;
  readonly confidence: number | null;
  readonly num_ends: number | null;
  readonly voxel_mm: number | null;
  readonly length_mm: number | null;
  readonly calibre_mm: number | null;
  readonly calibre_error_mm: number | null;
  readonly beyond_lps: readonly [number, number, number] | null;
  readonly slice_number: number | null;
  readonly num_slices: number | null;
  readonly has_clips: boolean;
  readonly statement: string;
  readonly explanation: string | null;
}

/** A lobe or a segment without a named bronchus in the tree. */
export interface AbsentAirway {
  readonly name: string;
  readonly reason: string;
  readonly lps: readonly [number, number, number] | null;
}

/** The airway tree and its measurements; sent after each change. */
export interface TreeMessage {
  readonly type: "tree";
  readonly tree: TreeDocument | null;
  readonly titles: readonly BranchTitle[];
  readonly measures: readonly BranchMeasures[] | null;
  readonly uncertain: readonly UncertainPlace[];
  readonly absent: readonly AbsentAirway[];
}

/** Answer to `live_path`: the path from the root to the point under the cursor, or a reason for its absence. */
export interface LivePathMessage {
  readonly type: "live_path";
  readonly request_id: number;
  readonly lps: readonly [number, number, number] | null;
  readonly points_lps: readonly (readonly [number, number, number])[];
  readonly length_mm: number | null;
  readonly min_diameter_mm: number | null;
  readonly confidence: number | null;
  readonly snapped_mm: number | null;
  readonly new_mm: number | null;
  readonly joins_branch_id: number | null;
  readonly problem: string | null;
  readonly from_carina_mm: number | null;
}

/** Cross-sections of a branch from its start to its end: parallel lists; null marks a failed measurement. */
export interface BranchProfile {
  readonly at_mm: readonly number[];
  readonly lumen_mm: readonly (number | null)[];
  readonly lumen_error_mm: readonly (number | null)[];
  readonly min_mm: readonly (number | null)[];
  readonly max_mm: readonly (number | null)[];
  readonly wall_mm: readonly (number | null)[];
  readonly at_junction: readonly boolean[];
}

/** Answer to `branch_detail`; profile and measurements are null until they are computed. */
export interface BranchDetailMessage {
  readonly type: "branch_detail";
  readonly request_id: number;
  readonly branch_id: number;
  readonly measures: BranchMeasures | null;
  readonly profile: BranchProfile | null;
}

/** The first message of the page: the token of its link. */
export interface PhoneHelloMessage {
  readonly type: "phone_hello";
  readonly wire_version: number;
  readonly token: string;
}

/** Orientation and pressed controls of the phone; sent while a control is pressed, and once after its release. */
export interface PhoneSampleMessage {
  readonly type: "phone_sample";
  readonly time_s: number;
  readonly orientation_wxyz: readonly [number, number, number, number] | null;
  readonly held: boolean;
  readonly advance: number;
}

/** Action of a button of the page: look along the path again, or change to the next control mode. */
export interface PhoneActMessage {
  readonly type: "phone_act";
  readonly action: "next_control" | "recenter";
}

/** State that the page shows, sent after each change; it contains no patient data. */
export interface PhoneStateMessage {
  readonly type: "phone_state";
  readonly case_open: boolean;
  readonly control: "absolute" | "path" | "relative";
  readonly scope_held: boolean;
  readonly holds: boolean;
  readonly words: string;
}

/** Lens model of this image: a direction (x, y, z) in camera space maps to centre + focal * (x', y').

    `brown`, with k1 k2 p1 p2 k3 k4 k5 k6, distorts (x/z, y/z); `fisheye`, with k1 to k4, puts the angle a from the
    axis at a distance of a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9. */
export interface PictureLens {
  readonly model: "brown" | "fisheye";
  readonly coefficients: readonly number[];
  readonly focal_px: readonly [number, number];
  readonly centre_px: readonly [number, number];
  readonly limit_rad: number;
}

/** Geometry of an image of a curved surface: parallel lists over selected rows, to be interpolated linearly.

    Pixel (column, row) is at `start_lps + column * step_lps`, in corner coordinates of *this* image. */
export interface PictureLines {
  readonly row: readonly number[];
  readonly start_lps: readonly (readonly [number, number, number])[];
  readonly step_lps: readonly (readonly [number, number, number])[];
  readonly path_mm: readonly number[];
  readonly path_column: readonly number[];
  readonly mm_per_px: number;
}

/** The outline of the lumen in this image, encoded in the last bytes of the message, after the image data.

    Each line is encoded as the number of its points (u16), then column and row of each point, u16 little-endian, in
    sixteenths of a pixel of *this* image (corner coordinates). The last point of a closed line equals its first point. */
export interface PictureOutline {
  readonly num_bytes: number;
  readonly complete: boolean;
}

/** The outline of one part of a layer (vessels, fissures, lobes, reach) in this image.

    The bytes of the layers are between the image data and the lumen outline, in the order of the list, and are encoded
    like the outline. Their coordinates are sixteenths of a unit of the layer, which does not depend on the zoom, so
    that every line is closed. */
export interface PictureLayer {
  readonly num_bytes: number;
  readonly complete: boolean;
  readonly layer: "fissures" | "lobes" | "reach" | "vessels";
  readonly part: string;
  readonly pixel_from_line: readonly number[];
}

/** Header of a binary image message; the payload follows the header. */
export interface PictureHeader {
  readonly frame_id: number;
  readonly view: "airway" | "axial" | "coronal" | "curved" | "cut-plane" | "drr" | "sagittal" | "straightened" | "tree" | "tri-plane" | "xray-axial" | "xray-coronal" | "xray-sagittal";
  readonly stands_for: "airway" | "axial" | "coronal" | "curved" | "cut-plane" | "drr" | "sagittal" | "straightened" | "tree" | "tri-plane" | "xray-axial" | "xray-coronal" | "xray-sagittal" | null;
  readonly pose_id: number;
  readonly lps_from_camera: readonly number[] | null;
  readonly fov_deg: number | null;
  readonly lens: PictureLens | null;
  readonly lps_from_pixel: readonly number[] | null;
  readonly lines: PictureLines | null;
  readonly outline: PictureOutline | null;
  readonly width: number;
  readonly height: number;
  readonly step_vox: number | null;
  readonly codec: "jpeg" | "png";
  readonly quality: number;
  readonly full: boolean;
  readonly empty: boolean;
  readonly decorated: readonly ("fog" | "hue" | "membrane" | "rings" | "secretions" | "specks" | "spurs" | "texture" | "vessels")[];
  readonly render_ms: number;
  readonly method: string;
  readonly layers?: readonly PictureLayer[];
  readonly breathes?: boolean;
}

/** Initial value of `look`. */
export const FIRST_LOOK: Look = {
  "scope": "generic",
  "outline": "round",
  "fov_deg": 120.0,
  "operator": "head"
};

/** Initial value of `sight`. */
export const FIRST_SIGHT: Sight = {
  "crosshair_lps": null,
  "window": null,
  "slab": {
    "thickness_mm": 0.0,
    "kind": "min"
  },
  "zoom": {},
  "orbits": {},
  "carm": {
    "primary_deg": 0.0,
    "secondary_deg": 0.0,
    "mm_per_px": null,
    "tone": "radiograph"
  },
  "reformation": {
    "turn_deg": 0.0,
    "mm_per_px": null
  },
  "shading": true,
  "texture": true,
  "method": "leap"
};

/**
 * Commands that set one field of `look` or `sight`, to the value of their field `from`; null uses all fields
 * of the command. With `by_view` the field has a value for each view.
 */
export const SETS = {
  set_operator: { of: "look", field: "operator", from: "position", by_view: false },
  set_fov: { of: "look", field: "fov_deg", from: "fov_deg", by_view: false },
  set_outline: { of: "look", field: "outline", from: "outline", by_view: false },
  set_crosshair: { of: "sight", field: "crosshair_lps", from: "lps", by_view: false },
  set_window: { of: "sight", field: "window", from: null, by_view: false },
  set_slab: { of: "sight", field: "slab", from: null, by_view: false },
  set_zoom: { of: "sight", field: "zoom", from: null, by_view: true },
  set_orbit: { of: "sight", field: "orbits", from: null, by_view: true },
  set_carm: { of: "sight", field: "carm", from: null, by_view: false },
  set_reformation: { of: "sight", field: "reformation", from: null, by_view: false },
  set_shading: { of: "sight", field: "shading", from: "on", by_view: false },
  set_texture: { of: "sight", field: "texture", from: "on", by_view: false },
  set_method: { of: "sight", field: "method", from: "method", by_view: false },
} as const;

/** Messages of a client that are not commands; `handled` does not count them. */
export const NO_COMMANDS: readonly string[] = ["hello", "open_upload", "import_mask", "import_target", "measure_upload", "layout", "ack", "probe", "pick", "live_path", "branch_detail", "set_frame_rate", "set_processor", "set_layers", "ask_series_pictures", "stop_series_pictures", "ask_storage", "set_watch_page", "send_away", "accept_notice", "read_hints", "device_sample", "connect_device", "disconnect_device", "publish_tip", "set_phone", "watch_devices", "start_recording", "target_mark", "preview_edit", "open_key_frames", "ask_pacs", "save_pacs", "remove_pacs", "test_pacs", "search_pacs", "ask_pacs_series", "get_pacs_series", "stop_pacs", "empty_pacs", "send_plan_to_pacs"];

export type ClientMessage =
  | OpenPathMessage
  | OpenSeriesMessage
  | OpenDemoMessage
  | OpenRecentMessage
  | BeginAnewMessage
  | RenameCaseMessage
  | ForgetCaseMessage
  | RestoreCaseMessage
  | EmptyForgottenMessage
  | EmptyCtCacheMessage
  | KeepCtsMessage
  | CloseCaseMessage
  | CancelMessage
  | UndoMessage
  | RedoMessage
  | SaveCaseMessage
  | GoToStepMessage
  | SetRootMessage
  | SetLumenThresholdMessage
  | AddTargetMessage
  | RemoveTargetMessage
  | ChooseRouteMessage
  | EditTreeMessage
  | DeviceGoneMessage
  | TakeDeviceMessage
  | SetControlMessage
  | SetControlsMessage
  | CalibrateMessage
  | ArmPenMessage
  | JoinPenMessage
  | StopRecordingMessage
  | RenameFlightMessage
  | DescribeFlightMessage
  | MoveFlightMessage
  | FlyFlightMessage
  | RemoveFlightMessage
  | SteerMessage
  | SetModeMessage
  | ToggleModeMessage
  | GoToMessage
  | NextForkMessage
  | PreviousForkMessage
  | PlaceMessage
  | ShowPlaceMessage
  | LevelHorizonMessage
  | ResetLookMessage
  | SetBreathingMessage
  | CoughMessage
  | SetOperatorMessage
  | EditKeyFramesMessage
  | SetKeyFrameFlightMessage
  | ShowKeyFrameMessage
  | FlyKeyFramesMessage
  | SetFovMessage
  | SetOutlineMessage
  | SetScopeMessage
  | SetTransferMessage
  | SetCrosshairMessage
  | SetWindowMessage
  | SetSlabMessage
  | SetZoomMessage
  | SetOrbitMessage
  | SetCarmMessage
  | SetReformationMessage
  | SetShadingMessage
  | SetTextureMessage
  | SetMethodMessage
  | AnswerMaskMessage
  | DismissMaskMessage
  | SetPlanOptionsMessage
  | MeasureMovementMessage
  | MeasureMovementFromCaseMessage
  | DescribeTargetMessage
  | ChoosePlannedRouteMessage
  | ChoosePairMessage
  | SetAvailableScopesMessage
  | SeeTurnMessage
  | KeepDriveMessage
  | GrowTargetMessage
  | ConfirmTargetMessage
  | ResizeTargetMessage
  | BrushTargetMessage
  | AimTargetMessage
  | MarkSphereMessage
  | MapLungsMessage
  | MapReachMessage
  | StartTaskMessage
  | PauseTaskMessage
  | StopTaskMessage
  | ScoreFlightMessage
  | ReadTrainingFilesMessage
  | MarkExpertMessage
  | CompareFlightMessage
  | AddLearnerMessage
  | ChooseLearnerMessage
  | RemoveLearnerMessage
  | StartQuizMessage
  | AnswerQuizMessage
  | NextQuestionMessage
  | RepeatQuestionMessage
  | StopQuizMessage
  | ClientHelloMessage
  | OpenUploadMessage
  | ImportMaskMessage
  | ImportTargetMessage
  | MeasureUploadMessage
  | LayoutMessage
  | AckMessage
  | ProbeMessage
  | PickMessage
  | AskLivePathMessage
  | AskBranchDetailMessage
  | SetFrameRateMessage
  | SetProcessorMessage
  | SetLayersMessage
  | AskSeriesPicturesMessage
  | StopSeriesPicturesMessage
  | AskStorageMessage
  | SetWatchPageMessage
  | SendAwayMessage
  | AcceptNoticeMessage
  | ReadHintsMessage
  | DeviceSampleMessage
  | ConnectDeviceMessage
  | DisconnectDeviceMessage
  | PublishTipMessage
  | SetPhoneMessage
  | WatchDevicesMessage
  | StartRecordingMessage
  | AskTargetMarkMessage
  | AskEditPreviewMessage
  | OpenKeyFramesMessage
  | AskPacsMessage
  | SavePacsMessage
  | RemovePacsMessage
  | TestPacsMessage
  | SearchPacsMessage
  | AskPacsSeriesMessage
  | GetPacsSeriesMessage
  | StopPacsMessage
  | EmptyPacsMessage
  | SendPlanToPacsMessage;

export type ServerMessage =
  | FlightsMessage
  | DevicesMessage
  | StartMarkedMessage
  | PenMessage
  | TargetMarkMessage
  | LungsMessage
  | PlansMessage
  | ServerHelloMessage
  | StartMessage
  | SeriesPictureMessage
  | OpeningMessage
  | StateMessage
  | HistoryMessage
  | RouteMessage
  | PoseMessage
  | ProgressMessage
  | DoneMessage
  | ErrorMessage
  | NoticeMessage
  | WatchingMessage
  | ProcessorChoiceMessage
  | HandledMessage
  | ValueMessage
  | PickedMessage
  | StatusMessage
  | ClusterMessage
  | EditPreviewMessage
  | NoEvidenceMessage
  | KeyFramesMessage
  | PacsConnectionsMessage
  | PacsTestMessage
  | PacsStudiesMessage
  | PacsSeriesMessage
  | PacsPreviewMessage
  | PacsSentMessage
  | PacsProblemMessage
  | TrainingMessage
  | TreeMessage
  | LivePathMessage
  | BranchDetailMessage;

export type PhoneMessage =
  | PhoneHelloMessage
  | PhoneSampleMessage
  | PhoneActMessage;

export type ToPhoneMessage =
  | PhoneStateMessage;
