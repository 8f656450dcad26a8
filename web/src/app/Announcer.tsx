/** The live region of the page, which announces forks, the end of the route and wrong branches to screen readers. */

import { useRef } from "react";
import { type Announcement, announcementOf, type WayAhead } from "../state/announcement";

/** Render the live region; a text is read once, when its fork or branch changes. */
export function Announcer({ way }: { way: WayAhead }) {
  const last = useRef<Announcement | null>(null);
  const now = announcementOf(way);
  if (now === null || now.key !== last.current?.key) last.current = now;
  return (
    <p className="visually-hidden" aria-live="polite" aria-atomic="true" data-testid="announcer">
      {last.current?.text ?? ""}
    </p>
  );
}
