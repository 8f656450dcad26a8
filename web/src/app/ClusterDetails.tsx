/** Table of the cluster computers that render together with this one: share and delay of each. */

import { memberText } from "../state/cluster-text";
import { fixed } from "../state/format";
import type { ClusterMessage } from "../wire/messages";

/** Render the share, response time and status of each machine of a cluster. */
export function ClusterDetails({ cluster }: { cluster: ClusterMessage }) {
  return (
    <section className="cluster" aria-label="Rendering machines">
      <p className="quiet">
        {cluster.address} · {fixed(cluster.fps)} frames/s
        {cluster.frame_ms === null ? "" : `, ${fixed(cluster.frame_ms)} ms per frame`}
        {cluster.mixed ? " · CPUs and GPUs mixed: images agree to within one grey level" : ""}
      </p>
      {cluster.alone ? <p>No other machine is available. This machine renders alone.</p> : null}
      <table className="numbers">
        <thead>
          <tr>
            <th>machine</th>
            <th>share</th>
            <th>response time</th>
            <th>late frames</th>
            <th>status</th>
          </tr>
        </thead>
        <tbody>
          {cluster.members.map((member) => (
            <tr key={member.name} className={member.state === "ready" ? undefined : "warning-text"}>
              <td title={`${member.threads} threads, ${member.simd}`}>
                {member.host === member.name ? member.name : `${member.host} (${member.name})`}
              </td>
              <td>{fixed(100 * member.share)} %</td>
              <td>{member.latency_ms === null ? "–" : `${fixed(member.latency_ms)} ms`}</td>
              <td>{member.num_late}</td>
              <td>{memberText(member)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}
