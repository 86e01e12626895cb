// selects the observations of the chosen sessions, kinds and runs
const rows = [];
const wanted = cb_obj.value;
for (let k = 0; k < source.data.run.length; k++) {
  const labels = ["session " + source.data.session[k], "kind " + source.data.kind[k], "run " + source.data.run[k]];
  if (labels.some((label) => wanted.includes(label))) rows.push(k);
}
source.selected.indices = rows;
