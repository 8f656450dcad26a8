/** Button and dialog that save a flight as a video. */

import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { FILM_SIZES, FILM_SPEEDS_MM_S, type FilmChoice, type FilmFlight, filmProblem } from "../state/film";
import { isSearchedInAirways } from "../state/fork-sheet";
import { useApp, useStation } from "./context";
import { Act, Choice, SwitchKey } from "./controls";
import { Figure } from "./Figure";

/** Render the button that opens the dialog for a flight; a disabled button states the reason. */
export function SaveVideo({ flight, testId }: { flight: FilmFlight; testId: string }) {
  const station = useStation();
  const watches = useApp((state) => state.watches);
  const problem = useApp((state) => filmProblem(state, flight));
  if (watches) return null;
  return (
    <Act
      icon="film"
      label="Save video"
      words={problem ?? "Save this flight as a video"}
      keys={flight.kind === "route" ? keyOf("save_video") : ""}
      disabled={problem !== null}
      testId={testId}
      onPress={() => station.films.open(flight)}
    />
  );
}

/** Render the dialog with the options of a video. */
export function FilmDialog() {
  const station = useStation();
  const flight = useApp((state) => state.ui.film);
  return (
    <ModalOverlay
      className="dialog-back"
      isOpen={flight !== null}
      isDismissable
      onOpenChange={(open) => {
        if (!open) station.ui({ film: null });
      }}
    >
      <Modal className="dialog film-dialog">
        <Dialog data-testid="film-dialog">
          <div className="dialog-head">
            <Heading slot="title">Save video</Heading>
            <Act
              kind="icon"
              icon="close"
              words="Close"
              keys={keyOf("leave")}
              onPress={() => station.ui({ film: null })}
            />
          </div>
          {flight === null ? null : <Options flight={flight} />}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Options({ flight }: { flight: FilmFlight }) {
  const station = useStation();
  const choice = useApp((state) => state.ui.filmChoice);
  const noVideo = useApp((state) => state.start?.no_video ?? null);
  const title = useTitle(flight);
  const namesTurns = useApp((state) => flight.kind === "route" && isSearchedInAirways(state));
  const change = (part: Partial<FilmChoice>) => station.ui({ filmChoice: { ...choice, ...part } });
  return (
    <>
      <p>{title}</p>
      <div className="film-options">
        <span className="film-label">Format</span>
        <Choice<FilmChoice["format"]>
          name="Format"
          value={choice.format}
          choices={[
            { value: "mp4", label: "MP4", words: "H.264, plays in every player" },
            { value: "webm", label: "WebM", words: "VP9, smaller; for web pages" },
          ]}
          onChange={(format) => change({ format })}
        />
        <span className="film-label">Size</span>
        <Choice<FilmChoice["size"]>
          name="Size"
          value={choice.size}
          choices={(["small", "hd", "fullHd", "square"] as const).map((value) => ({
            value,
            label: FILM_SIZES[value].label,
            words: "Width and height in pixels",
          }))}
          onChange={(size) => change({ size })}
        />
        <span className="film-label">Speed</span>
        {flight.kind === "route" ? (
          <Figure
            label="Speed"
            quiet
            unit="mm/s"
            value={choice.speedMmS}
            choices={FILM_SPEEDS_MM_S}
            testId="film-speed"
            onChange={(speed) => change({ speedMmS: speed ?? choice.speedMmS })}
          />
        ) : (
          <span className="quiet">{flight.kind === "recording" ? "As recorded" : "As set for the key frames"}</span>
        )}
        <span className="film-label">Captions</span>
        <SwitchKey
          name={`Captions: ${choice.captions ? "on" : "off"}`}
          label={choice.captions ? "On" : "Off"}
          words={namesTurns ? "Time, branch, depth, and the next turn with its clock hour" : "Time, branch and depth"}
          on={choice.captions}
          testId="film-captions"
          onChange={() => change({ captions: !choice.captions })}
        />
      </div>
      {noVideo === null ? null : (
        <p className="warning-text" data-testid="film-problem">
          {`${noVideo.charAt(0).toUpperCase()}${noVideo.slice(1)}`}
        </p>
      )}
      <p className="quiet">The file contains no patient name. Carina is not a medical device.</p>
      <div className="dialog-actions">
        <Act
          kind="primary"
          label="Save video"
          words={noVideo === null ? "Render the video; the bar at the top shows the progress" : noVideo}
          disabled={noVideo !== null}
          testId="film-save"
          onPress={() => void station.films.save()}
        />
      </div>
    </>
  );
}

/** Return the title of a flight for the dialog. */
function useTitle(flight: FilmFlight): string {
  const route = useApp((state) => state.route?.title ?? "");
  const flights = useApp((state) => state.flights);
  switch (flight.kind) {
    case "route":
      return `Flight to ${route}, with a stop at each fork`;
    case "key_frames":
      return "Flight through the key frames";
    case "recording":
      return flights.find(({ number }) => number === flight.number)?.name ?? "Recorded flight";
  }
}
