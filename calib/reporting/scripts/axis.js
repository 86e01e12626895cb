// draws the gap along the runs against travelled distance or time
source.data.way = source.data["way " + cb_obj.value];
for (const axis of axes) axis.axis_label = cb_obj.value;
source.change.emit();
