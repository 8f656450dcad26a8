/** Statement on the CT: its properties, and the generation up to which airways can be trusted. */

import { sentence } from "../../state/format";
import type { CtStatement } from "../../wire/messages";
import { Icon } from "../icons";

/** Render the properties of the CT, those that limit the airways with a warning; a text until they are known. */
export function CtStatementList({ statement }: { statement: CtStatement | null }) {
  if (statement === null) return <p className="quiet">Kernel, motion and metal are being assessed.</p>;
  return (
    <section className="ct-statement" aria-label="Assessment of the CT" data-testid="ct-statement">
      <h3>Assessment of the CT</h3>
      <p className="trusted">{sentence(statement.trusted_words)}.</p>
      <dl className="facts">
        {statement.properties.map(({ name, text, limits }) => (
          <div key={name} className={limits ? "limits" : undefined}>
            <dt>
              {limits ? <Icon name="warning" /> : null}
              {sentence(name)}
            </dt>
            <dd>{sentence(text)}</dd>
          </div>
        ))}
      </dl>
    </section>
  );
}
