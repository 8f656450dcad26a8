/** Definitions and sources of the texts on the score screen that are no rows of a table. */

/** A definition with its source. */
export interface Definition {
  readonly title: string;
  readonly words: string;
}

/** Definitions of the score screen, in the order of the screen. */
export const SCORE_DEFINITIONS: readonly Definition[] = [
  {
    title: "Seen",
    words:
      "The opening of the segment was in sight for 0.5 s, or the tip was inside for 0.5 s with a clear view. In sight: " +
      "in the round picture, at least 1 % of its pixels, at least half of the opening unhidden, red-out below one half. " +
      "Definition of Carina.",
  },
  {
    title: "Visited",
    words:
      "The opening was in the middle of the picture for 1 s, nearer to it than all others, or the tip was inside for " +
      "0.5 s with a clear view. Definition of Carina.",
  },
  {
    title: "Clock",
    words:
      "It starts below the cords, where the tip enters the airways, or at the main carina if the task states so, and " +
      "stops during a pause. Definition of Carina.",
  },
  {
    title: "Return to a segment",
    words:
      "By default a return between two segments breaks the sequence of structured progress. No publication states the " +
      "rule; it is Carina's.",
  },
  {
    title: "Mastery",
    words:
      "Two procedures with 18 segments, 18 progressions and less than 120 s each (Cold 2024, Respiration, " +
      "10.1159/000542045); in a row: Carina's reading. A verdict needs six attempts (Konge 2011, Respiration 81:483).",
  },
  {
    title: "Columns of groups",
    words:
      "Novices, intermediates, experienced operators and a robot on a phantom (BronchoBot study, Cold 2025), measured " +
      "with another system: not directly comparable, and no pass marks.",
  },
  {
    title: "Does not count",
    words:
      "Conditions under which an attempt is scored but does not count in a verdict: cut off, paused, outside the " +
      "airways, jumps, another picture or instrument, uncertain names. Definitions of Carina.",
  },
  {
    title: "Map",
    words: "Colour: time at which a segment was seen. Thick lines were entered, thin lines were seen from outside.",
  },
  {
    title: "Timeline and moments",
    words:
      "Up to three faults to replay: wrong branches first, then the longest contacts. A contact is a touch within " +
      "0.1 mm of the wall; touches within 0.5 s are one. Definitions of Carina.",
  },
  {
    title: "Comparison with an expert",
    words:
      "By place, and not by time. Deviation: distance from the nearest pass of the expert within 2 mm along the branch; " +
      "its local variance is the mean variance within one second (deviation and variance: Deng, ICRA 2026; the limits " +
      "are Carina's). No threshold is published.",
  },
  {
    title: "High-error events",
    words:
      "Periods of at least 0.5 s with a deviation of more than 5 mm; periods less than 0.5 s apart are joined first " +
      "(number of high-error events: Deng, ICRA 2026, whose limits were not read; these limits are Carina's). No " +
      "threshold is published, and no pass mark. The letters on the timeline replay the three with the largest deviations.",
  },
];
