// Points of a trend that may stand in one line: runs of different profiles are not comparable.

/** The points of the profile of a run, the newest without one, from the first one to it. */
export function alike({ points }, run = undefined) {
  const last = points.find((point) => point.run === run) ?? points[points.length - 1];
  return points.slice(0, points.indexOf(last) + 1).filter(({ profile }) => profile === last.profile);
}
