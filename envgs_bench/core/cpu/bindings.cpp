// What Python sees, the same for every kind of CPU: compiled once, for any. Arrays are borrowed, never copied; the
// Python side keeps them alive as long as a pass is.
#include "bindings.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <tuple>

#include "parallel.h"
#include "rasterize.h"
#include "trace.h"

namespace nb = nanobind;

namespace {

using namespace envgs;

using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using OutInt = nb::ndarray<int32_t, nb::c_contig, nb::device::cpu>;
// Fields of Gaussians: means, quaternions, scales, opacities, sh, extras.
using InSet = std::tuple<In, In, In, In, In, In>;
// Fields of GaussianGradients: the same, and position gradients.
using OutSet = std::tuple<Out, Out, Out, Out, Out, Out, Out>;
// Fields of Planes: color, alpha, depth, normal, extras.
using OutPlanes = std::tuple<Out, Out, Out, Out, Out>;
using InPlanes = std::tuple<In, In, In, In, In>;
using GradientPlanes =
    std::tuple<std::optional<In>, std::optional<In>, std::optional<In>, std::optional<In>, std::optional<In>>;

Gaussians gaussians_of(const InSet& set) {
    const auto& [means, quaternions, scales, opacities, sh, extras] = set;
    return {means.data(),
            quaternions.data(),
            scales.data(),
            opacities.data(),
            sh.data(),
            extras.data(),
            int(means.shape(0)),
            int(sh.shape(1) * sh.shape(2) / 3),
            int(extras.shape(1)),
            sh.shape(2) == kSiteFloats};
}

GaussianGradients gradients_of(const OutSet& set) {
    const auto& [means, quaternions, scales, opacities, sh, extras, position_gradients] = set;
    return {means.data(),  quaternions.data(),       scales.data(), opacities.data(), sh.data(),
            extras.data(), position_gradients.data()};
}

Planes<float> planes_of(const OutPlanes& p) {
    const auto& [color, alpha, depth, normal, extras] = p;
    return {color.data(), alpha.data(), depth.data(), normal.data(), extras.data(), long(alpha.size())};
}
Planes<const float> planes_of(const InPlanes& p) {
    const auto& [color, alpha, depth, normal, extras] = p;
    return {color.data(), alpha.data(), depth.data(), normal.data(), extras.data(), long(alpha.size())};
}
Planes<const float> planes_of(const GradientPlanes& p, long pixels) {
    auto data = [](const std::optional<In>& plane) { return plane ? plane->data() : nullptr; };
    const auto& [color, alpha, depth, normal, extras] = p;
    return {data(color), data(alpha), data(depth), data(normal), data(extras), pixels};
}

PinholeCamera camera_of(const In& world_to_camera, const In& intrinsics, const In& pixel_to_direction, const In& center,
                        int width, int height, float near, bool low_pass, bool low_pass_statistics) {
    const float* m = world_to_camera.data();
    return {{load3(m), load3(m + 4), load3(m + 8)},
            {m[3], m[7], m[11]},
            load_mat3(intrinsics.data()),
            load_mat3(pixel_to_direction.data()),
            load3(center.data()),
            width,
            height,
            near,
            low_pass,
            low_pass_statistics};
}

}  // namespace

void envgs::bind(nb::module_& m) {
    m.doc() = "The core's CPU backend. Called through envgs_bench.core.rasterize and trace, which check their input.";
    nb::set_leak_warnings(false);  // objects that outlive the interpreter at exit are no fault of the user's
    m.def("sleep_while_waiting", &sleep_while_waiting, "From now on OpenMP threads that wait sleep, torch's too.");

    nb::class_<RasterPass>(m, "RasterPass")
        .def("forward",
             [](RasterPass& self,
                const OutPlanes& out,  // filled, P = H·W
                OutInt hits,           // [H·W] filled: primitives blended in each pixel
                Out weights            // [N] filled: sums of the blending weights
             ) {
                 nb::gil_scoped_release unlocked;
                 self.forward(planes_of(out), hits.data(), weights.data());
             })
        .def("backward",
             [](RasterPass& self,
                const InPlanes& out,             // as forward() filled them
                const GradientPlanes& gradient,  // dL/d(out), None for zero
                const OutSet& result,            // zeros, to be filled
                bool removals                    // Σ removal_square in place of dL/dopacity
             ) {
                 nb::gil_scoped_release unlocked;
                 Planes<const float> drawn = planes_of(out);
                 self.backward(drawn, planes_of(gradient, drawn.pixels), gradients_of(result), removals);
             })
        .def("list_lengths", &RasterPass::list_lengths);
    m.def("raster_pass", [](const InSet& set,          // surfels or 3D Gaussians, by the columns of scales
                            In world_to_camera,        // [4, 4] rigid
                            In intrinsics,             // [3, 3] pixels
                            In pixel_to_direction,     // [3, 3] (x, y, 1) to a world direction with camera z = 1
                            In center,                 // [3] world units
                            int width,                 // pixels
                            int height,                // pixels
                            float near,                // nearest camera-frame depth that is drawn, world units
                            bool low_pass,             // whether to anti-alias
                            bool low_pass_statistics,  // whether statistics count what a surfel's low-pass answers
                            In background,             // [3] in [0, 1]
                            float transmittance_min,   // a pixel is finished below this
                            int threads                // workers; results depend on their number
                         ) {
        bool surfels = std::get<2>(set).shape(1) == 2;
        PinholeCamera camera = camera_of(world_to_camera, intrinsics, pixel_to_direction, center, width, height, near,
                                         low_pass, low_pass_statistics);
        return make_raster_pass(gaussians_of(set), surfels, camera, load3(background.data()), transmittance_min,
                                threads);
    });

    nb::class_<Bvh>(m, "Bvh").def("__init__", [](Bvh* self,
                                                 const InSet& set,  // surfels
                                                 int threads        // workers that build it
                                              ) {
        nb::gil_scoped_release unlocked;
        new (self) Bvh(gaussians_of(set), threads);
    });
    nb::class_<TracePass>(m, "TracePass")
        .def("__init__",
             [](TracePass* self,
                std::shared_ptr<Bvh> bvh,  // over `set`
                const InSet& set,          // surfels
                In origins,                // [R, 3] world units
                In directions,             // [R, 3] world frame, any length; zero hits nothing
                In transmittance_min,      // [R] a ray ends with the hit that takes it below this
                In background,             // [3] in [0, 1]
                float t_min,               // hits at smaller t are not drawn, units of |direction|
                bool sh_along_ray,         // SH at the ray's direction; else toward each surfel's center
                int threads                // workers; sums over rays depend on their number
             ) {
                 RayBatch rays = {origins.data(), directions.data(), transmittance_min.data(), int(origins.shape(0))};
                 new (self) TracePass(std::move(bvh), gaussians_of(set), rays, load3(background.data()), t_min,
                                      sh_along_ray, threads);
             })
        .def("forward",
             [](TracePass& self,
                const OutPlanes& out,  // filled, P = R
                OutInt hits,           // [R] filled: surfels blended along each ray
                Out weights,           // [N] filled: sums of the blending weights
                bool keep_hits         // remember hits for backward()
             ) {
                 nb::gil_scoped_release unlocked;
                 self.forward(planes_of(out), hits.data(), weights.data(), keep_hits);
             })
        .def("backward", [](TracePass& self,
                            const InPlanes& out,             // as forward() filled them
                            const GradientPlanes& gradient,  // dL/d(out), None for zero
                            const OutSet& result,            // zeros, to be filled
                            Out origins,                     // [R, 3] filled: dL/dorigins
                            Out directions,                  // [R, 3] filled: dL/ddirections
                            bool removals                    // Σ removal_square in place of dL/dopacity
                         ) {
            nb::gil_scoped_release unlocked;
            Planes<const float> drawn = planes_of(out);
            self.backward(drawn, planes_of(gradient, drawn.pixels), gradients_of(result),
                          {origins.data(), directions.data()}, removals);
        });
}
