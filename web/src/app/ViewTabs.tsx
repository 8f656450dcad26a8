/** Buttons that scroll the strip of side views to a view; shown where the side views are a strip (touch screens). */

import { Button } from "react-aria-components";
import { SIDE_CELLS, type SideCell } from "../state/view-table";
import { VIEWS } from "../wire/views";
import { useApp } from "./context";

/** Render one button for each cell of the side views. */
export function ViewTabs() {
  const shown = useApp((state) => state.ui.shown);
  return (
    <nav className="view-tabs" aria-label="Side views">
      {SIDE_CELLS.map((cell) => (
        <Button
          key={cell}
          className="list-choice"
          aria-label={`Scroll to ${VIEWS[shown[cell]].title}`}
          data-testid={`view-tab-${cell}`}
          onPress={() => scrollTo(cell)}
        >
          {VIEWS[shown[cell]].title}
        </Button>
      ))}
    </nav>
  );
}

function scrollTo(cell: SideCell): void {
  document.querySelector(`.cell[data-cell="${cell}"]`)?.scrollIntoView({ inline: "start", block: "nearest" });
}
