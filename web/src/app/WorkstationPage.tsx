/** The workstation: the airway large, the other pictures around it, the step's panel at its side. */

import { AirwayStage } from "./AirwayStage";
import { BranchList } from "./BranchList";
import { useApp } from "./context";
import { DevicePanel } from "./DevicePanel";
import { KeyPanel } from "./KeyPanel";
import { DropChoice, MaskDialog } from "./MaskImport";
import { PathBar } from "./PathBar";
import { SideViews } from "./SideViews";
import { StatusBar } from "./StatusBar";
import { StepPanel } from "./StepPanel";
import { TopBar } from "./TopBar";

export function WorkstationPage() {
  const full = useApp((state) => state.ui.full);
  const devicesOpen = useApp((state) => state.ui.devicesOpen);
  const keysOpen = useApp((state) => state.ui.keysOpen);
  const lost = useApp((state) => state.connection.status === "lost" || state.connection.status === "refused");
  return (
    <div className="workstation" data-testid="workstation" data-full={full ?? undefined} data-lost={lost || undefined}>
      <TopBar />
      <aside className="left-panel">
        <BranchList />
        {devicesOpen ? <DevicePanel /> : keysOpen ? <KeyPanel /> : <StepPanel />}
      </aside>
      <main className="pictures">
        <AirwayStage />
        <SideViews />
      </main>
      <PathBar />
      <StatusBar />
      <DropChoice />
      <MaskDialog />
    </div>
  );
}
