/** Source and licence of a bundled case: a short line that is never cut off, and a button for the full citation. */

import { Button, Dialog, DialogTrigger, Popover } from "react-aria-components";
import { citationLine } from "../state/citation";
import type { Citation as CitationFields } from "../wire/messages";
import { Tip } from "./controls";

/** Render the short source line of a bundled case, and the button for its full citation. */
export function Citation({ from }: { from: CitationFields }) {
  return (
    <DialogTrigger>
      <Tip words="Full source and licence">
        <Button className="citation" data-testid="citation">
          <strong>{`${from.collection}, ${from.licence}, doi:`}</strong>
          <span>{from.doi}</span>
        </Button>
      </Tip>
      <Popover className="popover citation-full" placement="top start" offset={6}>
        <Dialog aria-label="Source and licence">
          <p>{citationLine(from)}</p>
        </Dialog>
      </Popover>
    </DialogTrigger>
  );
}
