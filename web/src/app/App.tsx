import { sentence } from "../state/format";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { KeyCard, NoticeDialog } from "./Dialogs";
import { Messages } from "./Messages";
import { PacsDialog } from "./PacsDialog";
import { StartPage } from "./StartPage";
import { WorkstationPage } from "./WorkstationPage";

/** Render the page: the start page, or the workstation with an open case. */
export function App() {
  const station = useStation();
  const hasCase = useApp((state) => state.session?.case != null);
  const greeted = useApp((state) => state.start !== null && state.session !== null);
  const connection = useApp((state) => state.connection);
  // When the access of a watcher ends, remove all patient data from the watcher's screen.
  const sentAway = useApp((state) => state.watches && state.connection.status === "refused");
  return (
    <>
      {hasCase && !sentAway ? (
        <WorkstationPage />
      ) : greeted && !sentAway ? (
        <StartPage />
      ) : (
        <main className="waiting">
          <h1>Carina</h1>
          <p>
            {connection.status === "refused"
              ? sentence(connection.reason ?? "")
              : connection.status === "lost"
                ? "Carina is not responding. Check that it is still running. This page keeps trying to reconnect."
                : "Connecting to Carina\u2026"}
          </p>
          {connection.status === "refused" && !sentAway ? (
            <Act kind="primary" label="Connect" words="Connect this window again" onPress={station.reconnect} />
          ) : null}
        </main>
      )}
      <Messages />
      <NoticeDialog />
      <KeyCard />
      <PacsDialog />
    </>
  );
}
