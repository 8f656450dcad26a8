import { useApp } from "./context";
import { KeyCard, NoticeDialog } from "./Dialogs";
import { Messages } from "./Messages";
import { StartPage } from "./StartPage";
import { WorkstationPage } from "./WorkstationPage";

export function App() {
  const hasCase = useApp((state) => state.session?.case != null);
  const greeted = useApp((state) => state.start !== null && state.session !== null);
  const connection = useApp((state) => state.connection);
  return (
    <>
      {hasCase ? (
        <WorkstationPage />
      ) : greeted ? (
        <StartPage />
      ) : (
        <main className="waiting">
          <h1>Carina</h1>
          <p>
            {connection.status === "refused"
              ? connection.reason
              : connection.status === "lost"
                ? "Carina is not responding. Check that it is still running. This page keeps trying to reconnect."
                : "Connecting to Carina\u2026"}
          </p>
        </main>
      )}
      <Messages />
      <NoticeDialog />
      <KeyCard />
    </>
  );
}
