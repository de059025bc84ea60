// Days as the reader counts them: in what somebody searches for, and in a filter.
import { language } from "./words.js";

const MONTH = "(?<name>\\p{L}{3,})\\.?";
const WRITTEN = [
  /(?<year>\d{4})[-/.](?<month>\d\d?)[-/.](?<day>\d\d?)/,
  /(?<!\d)(?<day>\d\d?)\/(?<month>\d\d?)\/(?<year>\d{4})/,
  /(?<!\d)(?<month>\d\d?)\/(?<day>\d\d?)\/(?<year>\d{4})/,
  /(?<day>\d\d?)\.(?<month>\d\d?)(?:\.(?<year>\d{4}))?(?!\d)/,
  /(?:(?<year>\d{4})年)?(?<month>\d\d?)月(?<day>\d\d?)日?/,
  new RegExp(`(?<day>\\d\\d?)\\s+${MONTH}(?:,?\\s+(?<year>\\d{4})(?: р\\.)?)?`, "u"),
  new RegExp(`${MONTH}\\s+(?<day>\\d\\d?)(?!\\d)(?:,?\\s+(?<year>\\d{4}))?`, "u"),
];

/** @type {Intl.DateTimeFormatOptions[]} */
const STYLES = [{ day: "numeric", month: "long" }, { day: "numeric", month: "short" }];

/** Number of a month by its name, or the beginning of it; 0 for any other word. */
function monthOf(name) {
  const names = (month) => STYLES.map((style) =>
    new Intl.DateTimeFormat(language.get(), style).formatToParts(new Date(2024, month, 1)).find(({ type }) => type === "month").value.toLowerCase());
  return Array.from({ length: 12 }, (_, month) => names(month)).findIndex((known) => known.some((one) => one.startsWith(name))) + 1;
}

/** What of a text a pattern takes for a day, and its hours; null without one. */
function read(text, pattern) {
  const found = text.match(pattern);
  const groups = found?.groups;
  const month = groups && (groups.name ? monthOf(groups.name) : Number(groups.month));
  const begin = month && new Date(Number(groups.year ?? new Date().getFullYear()), month - 1, Number(groups.day));
  if (!begin || begin.getMonth() !== month - 1) return null;
  const hours = Array.from({ length: 24 }, (_, hour) => new Date(begin.getTime() + hour * 3.6e6).toISOString().toLowerCase());
  return { found: found[0], hours: hours.map((iso) => iso.slice(groups.year ? 0 : 4, 13)) };
}

/**
 * The first day in a text: what of the text names it, and the beginnings of its hours in UTC, as the bench writes them
 * (`2026-11-25t07`, without a year `-11-25t07`). The page shows local time. 5/11/2026 is one of two days: the hours of
 * both. Null without one.
 */
export function dayIn(text) {
  const [first, ...others] = WRITTEN.map((pattern) => read(text, pattern)).filter(Boolean);
  return first ? { ...first, hours: [first, ...others.filter(({ found }) => found === first.found)].flatMap(({ hours }) => hours) } : null;
}

/** When a day of the reader's begins, or one so many days later; empty for no day. */
export function beginOf(text, later = 0) {
  const moment = new Date(`${text}T00:00`);
  if (Number.isNaN(moment.valueOf())) return "";
  moment.setDate(moment.getDate() + later);
  return moment.toISOString();
}
