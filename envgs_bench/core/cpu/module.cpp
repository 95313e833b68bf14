// The extension's module for one kind of CPU.
#include "bindings.h"
#include "lanes.h"

NB_MODULE(NATIVE_MODULE, m) {
    envgs::bind(m);
    m.attr("pixel_lanes") = envgs::kPixelLanes;
}
