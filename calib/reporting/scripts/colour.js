// colours all panels by a column: names from a palette, numbers on a scale; the legend says which
const values = source.data[cb_obj.value];
const safe = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
const title = safe(titles[cb_obj.value]);
const labels = typeof values[0] === "string";
if (labels) {
  const names = [...new Set(values)].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
  source.data.colour = Array.from(values, (name) => palette[names.indexOf(name) % palette.length]);
  const marks = names.slice(0, most).map((name, k) =>
    `<span style="white-space:nowrap"><span style="color:${palette[k % palette.length]}">&#9679;</span> ` +
    `${safe(name) || "(none)"}</span>`);
  if (names.length > most) marks.push(`and ${names.length - most} more`);
  legend.text = `${title}: ${marks.join(" &emsp; ")}`;
} else {
  const known = Array.from(values).filter(Number.isFinite);
  const low = Math.min(...known), high = Math.max(...known);
  const stops = ramp.map((colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16)));
  const at = (value) => {
    if (!Number.isFinite(value)) return "#BBBBBB";
    const place = high > low ? ((value - low) / (high - low)) * (stops.length - 1) : 0;
    const k = Math.min(Math.floor(place), stops.length - 2);
    return `rgb(${stops[k].map((part, c) => Math.round(part + (place - k) * (stops[k + 1][c] - part))).join(",")})`;
  };
  source.data.colour = Array.from(values, at);
  const digits = (value) => Number(value.toPrecision(4));
  const bar = `<span style="display:inline-block;width:9rem;height:0.7rem;vertical-align:middle;` +
    `background:linear-gradient(to right,${ramp.join(",")})"></span>`;
  legend.text = `${title}: ${digits(low)} ${bar} ${digits(high)}` +
    (known.length < values.length ? ' &emsp; <span style="color:#BBBBBB">&#9679;</span> not measured' : "");
}
source.change.emit();
