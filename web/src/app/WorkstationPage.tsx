/** Layout of the workstation: the large airway view, the other views around it, and the step's panel at the side. */

import { type CSSProperties, useEffect } from "react";
import { choosesTargetIn } from "../state/app-state";
import { expertFlight, trainingLayout } from "../state/training";
import { LEAD_VIEW } from "../wire/views";
import { AirwayStage } from "./AirwayStage";
import { BranchList } from "./BranchList";
import { ContinuedBar } from "./ContinuedBar";
import { CourseDialog } from "./CoursePanel";
import { useApp, useStation } from "./context";
import { DevicePanel } from "./DevicePanel";
import { FilmDialog } from "./FilmDialog";
import { Guide } from "./Guide";
import { HistoryList } from "./HistoryList";
import { KeyFramePanel } from "./KeyFramePanel";
import { Tabs } from "./ListHead";
import { DropChoice, MaskDialog } from "./MaskImport";
import { PathBar } from "./PathBar";
import { SaveDialog } from "./SaveDialog";
import { ScoreDialog } from "./ScoreDialog";
import { SheetHandle } from "./SheetHandle";
import { SideViews } from "./SideViews";
import { StatusBar } from "./StatusBar";
import { StepPanel } from "./StepPanel";
import { TargetComparisonDialog } from "./TargetComparison";
import { cursorOf } from "./ToolTag";
import { TopBar } from "./TopBar";
import { ViewTabs } from "./ViewTabs";
import { WatcherPanel } from "./WatcherPanel";

/** Render the page of an open case. */
export function WorkstationPage() {
  const full = useApp((state) => state.ui.full);
  const list = useApp((state) => state.ui.list);
  const panel = useApp((state) => state.ui.panel);
  const sheetOpen = useApp((state) => state.ui.sheetOpen);
  const armed = useApp((state) => state.ui.armed);
  const choosesTarget = useApp((state) => choosesTargetIn(state.ui));
  const training = useApp(trainingLayout);
  const station = useStation();
  // The browser leaves the whole screen by its own key too.
  useEffect(() => {
    const left = () => {
      if (document.fullscreenElement === null && station.state.ui.full === LEAD_VIEW) station.ui({ full: null });
    };
    document.addEventListener("fullscreenchange", left);
    return () => document.removeEventListener("fullscreenchange", left);
  }, [station]);
  const lost = useApp((state) => state.connection.status === "lost" || state.connection.status === "refused");
  return (
    <div
      className="workstation"
      data-testid="workstation"
      data-full={full === null ? undefined : full === LEAD_VIEW ? "lead" : "side"}
      data-lost={lost || undefined}
      data-armed={armed ?? undefined}
      data-attempt={training}
      data-choosing={choosesTarget ? "target" : undefined}
      style={armed === null ? undefined : ({ "--tool-cursor": cursorOf(armed) } as CSSProperties)}
    >
      <TopBar />
      <aside
        className="left-panel"
        data-panel={training === undefined ? panel : "step"}
        data-sheet={sheetOpen ? "open" : "closed"}
      >
        <SheetHandle />
        <ContinuedBar />
        {training !== undefined ? null : list === "history" ? <HistoryList /> : <BranchList />}
        {training !== undefined ? null : (
          <div className="panel-tabs">
            <Tabs place="panel" />
          </div>
        )}
        <Panel trains={training !== undefined} />
      </aside>
      <main className="pictures">
        <AirwayStage />
        <ViewTabs />
        <SideViews />
      </main>
      {training === undefined ? <PathBar /> : null}
      <StatusBar />
      <DropChoice />
      <MaskDialog />
      <SaveDialog />
      <FilmDialog />
      <ScoreDialog />
      <CourseDialog />
      <ExpertLoader />
      <TargetComparisonDialog />
      <Guide />
    </div>
  );
}

/** Load the path of the expert's flight after each change of the mark; render nothing. */
function ExpertLoader() {
  const station = useStation();
  const expert = useApp(expertFlight);
  useEffect(() => void station.transfers.loadExpert(expert), [station, expert]);
  return null;
}

/** Render the panel of the step, or the panel that replaces it; an attempt always has its clock and its end button. */
function Panel({ trains }: { trains: boolean }) {
  const devicesOpen = useApp((state) => state.ui.devicesOpen);
  const keysOpen = useApp((state) => state.ui.keysOpen);
  const watches = useApp((state) => state.watches);
  if (watches) return <WatcherPanel />;
  if (trains) return <StepPanel />;
  return devicesOpen ? <DevicePanel /> : keysOpen ? <KeyFramePanel /> : <StepPanel />;
}
