/** Source and licence of a bundled case: short and never cut, the whole text one press away. */

import { Button, Dialog, DialogTrigger, Popover } from "react-aria-components";
import { shortCitation } from "../state/citation";
import { Tip } from "./controls";

export function Citation({ text }: { text: string }) {
  const { source, doi } = shortCitation(text);
  return (
    <DialogTrigger>
      <Tip words="Source and licence in full">
        <Button className="citation" data-testid="citation">
          <strong>{doi === null ? source : `${source}, doi:`}</strong>
          {doi === null ? null : <span>{doi}</span>}
        </Button>
      </Tip>
      <Popover className="popover citation-full" placement="top start" offset={6}>
        <Dialog aria-label="Source and licence">
          <p>{text}</p>
        </Dialog>
      </Popover>
    </DialogTrigger>
  );
}
