/**
 * Errors and notices in one place, latest first. An error stays until the user closes it; a notice disappears after
 * {@link NOTICE_MS}.
 */

import { useEffect } from "react";
import type { Message } from "../state/app-state";
import { sentence } from "../state/format";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { Icon } from "./icons";

/** Display time of a notice, ms: enough to read two lines twice. */
const NOTICE_MS = 8000;
/** Minimum number of messages for the button that closes all of them. */
const MANY = 3;

/** Render the errors and notices. */
export function Messages() {
  const { store } = useStation();
  const messages = useApp((state) => state.messages);
  const closeAll = () => {
    for (const { id } of messages) store.dispatch({ kind: "dismiss", id });
  };
  return (
    <section className="messages" aria-label="Messages">
      {messages.length < MANY ? null : (
        <div className="close-all">
          <Act label={`Close all ${messages.length}`} words="I have read these" onPress={closeAll} />
        </div>
      )}
      {messages.map((message) => (
        <Card key={message.id} message={message} />
      ))}
    </section>
  );
}

function Card({ message }: { message: Message }) {
  const { store } = useStation();
  useEffect(() => {
    if (message.kind !== "notice") return;
    const timer = setTimeout(() => store.dispatch({ kind: "dismiss", id: message.id }), NOTICE_MS);
    return () => clearTimeout(timer);
  }, [message, store]);
  return (
    <div className={`message ${message.kind}`} role={message.kind === "error" ? "alert" : "status"}>
      <Icon name={message.kind === "error" ? "error" : "info"} />
      <div>
        <p>{sentence(message.message)}</p>
        {message.action === null ? null : <p className="action">{sentence(message.action)}</p>}
      </div>
      <Act
        kind="icon"
        icon="close"
        words={message.kind === "error" ? "I have read this" : "Close"}
        onPress={() => store.dispatch({ kind: "dismiss", id: message.id })}
      />
    </div>
  );
}
