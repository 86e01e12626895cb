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
