// draws the gap at the ends of the paths larger or smaller
const d = source.data;
d.arrow_x = Array.from(d.end_x, (x, k) => [x, x + cb_obj.value * d.off_x[k]]);
d.arrow_y = Array.from(d.end_y, (y, k) => [y, y + cb_obj.value * d.off_y[k]]);
source.change.emit();
