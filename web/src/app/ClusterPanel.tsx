/** Status of the cluster computers that render together with this one, and a panel with the share and delay of each. */

import { Button, Dialog, DialogTrigger, Popover } from "react-aria-components";
import { clusterText, memberText, needsLook } from "../state/cluster-text";
import { fixed } from "../state/format";
import { useApp } from "./context";

/** Render the status of the cluster computers; nothing without a cluster. */
export function ClusterPanel() {
  const cluster = useApp((state) => state.cluster);
  if (cluster === null) return null;
  return (
    <DialogTrigger>
      <Button className={`plain-text${needsLook(cluster) ? " warning-text" : ""}`} data-testid="cluster">
        {clusterText(cluster)}
      </Button>
      <Popover className="popover cluster" placement="top start" offset={6}>
        <Dialog aria-label="Rendering machines">
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
        </Dialog>
      </Popover>
    </DialogTrigger>
  );
}
