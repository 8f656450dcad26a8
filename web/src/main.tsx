import { createRoot } from "react-dom/client";
import { App } from "./app/App";
import { StationContext } from "./app/context";
import { exposeForTests } from "./app/test-hook";
import { Workstation } from "./app/workstation";
import "./app/styles/base.css";
import "./app/styles/controls.css";
import "./app/styles/workstation.css";
import "./app/styles/panels.css";
import "./app/styles/start.css";
import "./app/styles/pacs.css";
import "./app/styles/saved-files.css";
import "./app/styles/training.css";
import "./app/styles/plan-answer.css";
import "./app/styles/guide.css";
import "./app/styles/icon-labels.css";
import "./app/styles/narrow-window.css";
import "./app/styles/bottom-sheet.css";
import "./app/styles/touch.css";
import "./app/styles/contrast.css";

function socketAddress(): string {
  const address = new URL("./ws", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  address.search = "";
  address.hash = "";
  return address.href;
}

// The watcher's access token is in the URL fragment, because browsers do not send the fragment to the server.
const station = new Workstation(() => new WebSocket(socketAddress()), location.hash.slice(1) || null);
exposeForTests(station);
station.start();
const root = document.getElementById("root");
if (root === null) throw new Error("the page has no root element for the workstation");
createRoot(root).render(
  <StationContext value={station}>
    <App />
  </StationContext>,
);
