//: axis
// draws the gap along the runs against travelled distance or time
source.data.way = source.data["way " + cb_obj.value];
for (const axis of axes) axis.axis_label = cb_obj.value;
source.change.emit();
//: choose
// shows another channel or covariate
source.data.x = source.data["by " + by.value];
source.data.y = source.data["before " + channel.value];
source.data.b = source.data["before " + channel.value];
source.data.a = source.data["after " + channel.value];
x.axis_label = labels[by.value];
const unit = ` (${units[channel.value]})`;
y.axis_label = channel.value + unit;
b.axis_label = channel.value + " before" + unit;
a.axis_label = channel.value + " after" + unit;
band.bottom = -limits[channel.value];
band.top = limits[channel.value];
source.change.emit();
//: colour
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
//: enlarge
// draws the gap at the ends of the paths larger or smaller
const d = source.data;
d.arrow_x = Array.from(d.end_x, (x, k) => [x, x + cb_obj.value * d.off_x[k]]);
d.arrow_y = Array.from(d.end_y, (y, k) => [y, y + cb_obj.value * d.off_y[k]]);
source.change.emit();
//: highlight
const rows = [];
const wanted = cb_obj.value;
for (let k = 0; k < source.data.run.length; k++) {
  const labels = ["session " + source.data.session[k], "kind " + source.data.kind[k], "run " + source.data.run[k]];
  if (labels.some((label) => wanted.includes(label))) rows.push(k);
}
source.selected.indices = rows;
//: moment
// moves the marks along the paths to a time since the start of the run
const d = source.data;
const time = cb_obj.value;
for (const which of paths) {
  if (!(`${which}_t` in d)) continue;
  const place = (axis) => Array.from(d[`${which}_t`], (t, run) => {
    const values = d[`${which}_${axis}`][run];
    if (t.length === 0) return NaN;
    let k = 1;
    while (k < t.length - 1 && t[k] < time) k++;
    if (t.length < 2 || time >= t[t.length - 1]) return values[t.length - 1];
    const share = Math.max(0, (time - t[k - 1]) / Math.max(t[k] - t[k - 1], 1e-9));
    return values[k - 1] + Math.min(share, 1) * (values[k] - values[k - 1]);
  });
  d[`now_${which}_x`] = place("x");
  d[`now_${which}_y`] = place("y");
}
source.change.emit();
//: unpack
// unpacks the scripts in their order and runs them
(async () => {
  const place = document.currentScript ? document.currentScript.parentNode : document.body;
  if (typeof DecompressionStream === "undefined") {
    place.append("The panels need a browser of 2023 or later; the results are listed below.");
    return;
  }
  for (const packed of document.querySelectorAll('script[type="application/gzip"]')) {
    const bytes = Uint8Array.from(atob(packed.textContent), (sign) => sign.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }
})();
