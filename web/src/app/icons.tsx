/** Line icons of 16 px as SVG paths in the source, so that the page loads no icon files. */

const PATHS = {
  previousFork: "M3 3v10M13 3.5 6.5 8l6.5 4.5",
  back: "M10.5 3.5 5 8l5.5 4.5",
  forward: "M5.5 3.5 11 8l-5.5 4.5",
  nextFork: "M13 3v10M3 3.5 9.5 8 3 12.5",
  play: "M4.5 3v10l8-5z",
  stop: "M4.5 4.5h7v7h-7z",
  level: "M1.5 8h4M10.5 8h4M5.5 8a2.5 2.5 0 0 0 5 0",
  straight: "M8 13.5v-11M4.5 6 8 2.5 11.5 6M3 13.5h10",
  light:
    "M8 1.5v2M8 12.5v2M1.5 8h2M12.5 8h2M3.5 3.5l1.4 1.4M11.1 11.1l1.4 1.4M3.5 12.5l1.4-1.4M11.1 4.9l1.4-1.4M8 5.2a2.8 2.8 0 1 0 0 5.6 2.8 2.8 0 0 0 0-5.6",
  round: "M8 2.5a5.5 5.5 0 1 0 0 11 5.5 5.5 0 0 0 0-11M2 2h2M12 2h2M2 14h2M12 14h2",
  texture:
    "M3 4h.01M7 3h.01M11.5 4.5h.01M5 7.5h.01M9 7h.01M13 8.5h.01M3 11h.01M7.5 11.5h.01M11.5 12.5h.01M2.5 7.5h.01M5.5 13.5h.01",
  breathing: "M1.5 8c1.7-6.5 3.3-6.5 5 0s3.3 6.5 5 0c.7-2.7 1.7-4.3 3-4.8",
  routeLine: "M3 13.5c0-5 10-4 10-11M3 13.5h.01M13 2.5h.01",
  screen: "M1.5 3h13v8.5h-13zM5.5 14h5M8 11.5V14",
  full: "M2.5 6V2.5H6M10 2.5h3.5V6M13.5 10v3.5H10M6 13.5H2.5V10",
  fit: "M2 2h12v12H2zM5 8h6M5 8l1.8-1.8M5 8l1.8 1.8M11 8 9.2 6.2M11 8l-1.8 1.8",
  lumen: "M8 3c3.5 0 5.5 1.8 5.5 4.6S11.2 13 8 13s-5.2-2-5.2-5S4.5 3 8 3M8 7.9h.01",
  leaveFull: "M6 2.5V6H2.5M13.5 6H10V2.5M10 13.5V10h3.5M2.5 10H6v3.5",
  close: "M4 4l8 8M12 4l-8 8",
  warning: "M8 2 1.5 13.5h13zM8 6.5v3.2M8 11.7v.1",
  error: "M8 1.8a6.2 6.2 0 1 0 0 12.4A6.2 6.2 0 0 0 8 1.8M8 4.8v4M8 11v.2",
  info: "M8 1.8a6.2 6.2 0 1 0 0 12.4A6.2 6.2 0 0 0 8 1.8M8 7.2v4M8 4.8v.2",
  chevron: "M6 3.5 10.5 8 6 12.5",
  down: "M3.5 6 8 10.5 12.5 6",
  target: "M8 2.5 13.5 8 8 13.5 2.5 8z",
  undo: "M3 6.5h6.5a3.5 3.5 0 0 1 0 7H6M6 3.5l-3 3 3 3",
  redo: "M13 6.5H6.5a3.5 3.5 0 0 0 0 7H10M10 3.5l3 3-3 3",
  folder: "M1.5 12.5v-9h4.5l1.5 2h7v7z",
  file: "M3.5 1.5h6l3 3v10h-9zM9.5 1.5v3h3",
  swap: "M4.5 2.5 2 5l2.5 2.5M2 5h10M11.5 8.5 14 11l-2.5 2.5M14 11H4",
  operator: "M8 2.2a2.3 2.3 0 1 0 0 4.6 2.3 2.3 0 0 0 0-4.6M3.5 14c0-3 2-4.7 4.5-4.7s4.5 1.7 4.5 4.7",
  search: "M7 2.5a4.5 4.5 0 1 0 0 9 4.5 4.5 0 0 0 0-9M10.3 10.3 14 14",
  pencil: "M3 13l.8-3.2L10.6 3l2.4 2.4-6.8 6.8zM9.3 4.3l2.4 2.4",
  addBranch: "M5 14V9L2.5 4M5 9l4-4M11.5 9.5v5M9 12h5",
  bridge: "M1.5 11.5h3M11.5 11.5h3M4.5 11.5v-2M11.5 11.5v-2M4.5 9.5a3.5 3.5 0 0 1 7 0",
  cut: "M4.5 9.5a2 2 0 1 0 0 4 2 2 0 0 0 0-4M11.5 9.5a2 2 0 1 0 0 4 2 2 0 0 0 0-4M5.6 9.8 11 2.5M10.4 9.8 5 2.5",
  fork: "M8 14V9M8 9 3.5 3M8 9l4.5-6M8 7.2a1.8 1.8 0 1 0 0 3.6 1.8 1.8 0 0 0 0-3.6",
  smooth: "M1.5 11c3 0 3.5-6 6.5-6s3.5 6 6.5 6",
  paint: "M13.5 2.5 7 9M7 9c-2-.5-3.5 1-3.5 2.5 0 1-.5 1.7-1.5 2 3 1 6 0 6-2.5 0-.8-.3-1.6-1-2",
  erase: "M6 13.5 2.5 10 9 3.5l4.5 4.5-5.5 5.5zM5.5 7l4.5 4.5M6 13.5h7.5",
  key: "M3.5 2v12M3.5 3h8.5l-2 2.8 2 2.7H3.5",
  pause: "M5.5 3.5v9M10.5 3.5v9",
  up: "M3.5 10 8 5.5 12.5 10",
  capture: "M2 5.5V2.5h3M11 2.5h3v3M14 10.5v3h-3M5 13.5H2v-3M8 6a2 2 0 1 0 0 4 2 2 0 0 0 0-4",
  picture: "M2 3h12v10H2zM2 11l3.5-3.5 2.5 2.5 2.5-3 3.5 4M5 5.7h.01",
  film: "M2 3h12v10H2zM5 3v10M11 3v10M2 6.3h3M2 9.7h3M11 6.3h3M11 9.7h3",
  root: "M8 13.5V6M8 6 4.5 9M8 6l3.5 3M3 2.5h10",
} as const;

/** Name of an icon. */
export type IconName = keyof typeof PATHS;

/** Return the SVG path of an icon in a square of side 16, for drawings outside React. */
export const outlineOfIcon = (name: IconName): string => PATHS[name];

/** Render the line icon of a name, 16 px wide and high; assistive technology ignores it. */
export function Icon({ name }: { name: IconName }) {
  return (
    <svg className="icon" viewBox="0 0 16 16" aria-hidden="true">
      <path d={PATHS[name]} />
    </svg>
  );
}
