import { describe, expect, it } from "vitest";
import { DownloadError } from "../net/download";
import { downloadMessage } from "./download-message";

const stopped = new DownloadError("export.video-stopped", "the video was cancelled");

describe("downloadMessage", () => {
  it("A video that this window has cancelled has no message; one that another window has cancelled has one.", () => {
    expect(downloadMessage(stopped, "The video", true)).toBeNull();
    expect(downloadMessage(stopped, "The video", false)?.message).toBe("The video was cancelled in another window.");
  });

  it("A video that the server stopped for another case has the server's reason.", () => {
    const lost = new DownloadError("export.video-lost", "the video was cancelled because another case was opened");
    expect(downloadMessage(lost, "The video", true)?.message).toMatch(/another case was opened/);
  });

  it("A lost connection states what to check.", () => {
    const message = downloadMessage(new TypeError("no network"), "The picture", false);
    expect(message?.message).toBe("The picture could not be downloaded from Carina.");
    expect(message?.action).toMatch(/still running/);
  });
});
