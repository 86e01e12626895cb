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
