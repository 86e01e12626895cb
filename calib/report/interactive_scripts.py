"""What the panels of a page do in the browser, as scripts."""

from __future__ import annotations

from typing import Final

#: selects the units of the chosen sessions, kinds and runs
LIGHT: Final = """
const rows = [];
const wanted = cb_obj.value;
for (let k = 0; k < source.data.run.length; k++) {
  const labels = ["session " + source.data.session[k], "kind " + source.data.kind[k], "run " + source.data.run[k]];
  if (labels.some((label) => wanted.includes(label))) rows.push(k);
}
source.selected.indices = rows;
"""

#: unpacks the scripts in their order and runs them
UNPACK: Final = """
(async () => {
  const place = document.currentScript ? document.currentScript.parentNode : document.body;
  if (typeof DecompressionStream === "undefined") {
    place.append("The panels need a browser of 2023 or later; all that is said stands above.");
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
"""

#: shows another channel or covariate
CHOOSE: Final = """
source.data.x = source.data["by " + by.value];
source.data.y = source.data["before " + channel.value];
source.data.b = source.data["before " + channel.value];
source.data.a = source.data["after " + channel.value];
x.axis_label = labels[by.value];
const unit = ", " + units[channel.value];
y.axis_label = channel.value + unit;
b.axis_label = channel.value + " before" + unit;
a.axis_label = channel.value + " after" + unit;
band.bottom = -floors[channel.value];
band.top = floors[channel.value];
source.change.emit();
"""

#: draws the gap at the ends of the paths larger or smaller
ENLARGE: Final = """
const d = source.data;
d.arrow_x = Array.from(d.end_x, (x, k) => [x, x + cb_obj.value * d.off_x[k]]);
d.arrow_y = Array.from(d.end_y, (y, k) => [y, y + cb_obj.value * d.off_y[k]]);
source.change.emit();
"""
