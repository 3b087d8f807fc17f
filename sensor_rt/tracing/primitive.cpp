#include "sensor_rt/tracing/primitive.h"

#include <cmath>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

// Conditions are combined by & and applied as factors: the loops vectorise only without branches.

/// Returns a finite reciprocal of a direction component, so that 0 * infinity never occurs.
inline double safe_reciprocal(double d) { return 1.0 / (d + std::copysign(1e-200, d)); }

/// Returns the first positive end of the interval [enter, leave] in which a ray is inside a convex solid.
inline double first_crossing(double enter, double leave) {
  const double first = enter > 0.0 ? enter : leave;
  return (enter <= leave) & (leave > 0.0) ? first : kNoHit;
}

SENSOR_RT_MULTIVERSION
void intersect_sphere(double radius, const Lanes3& __restrict o, const Lanes3& __restrict d,
                      double* __restrict t, Lanes3& __restrict n) {
  for (int l = 0; l < kLanes; ++l) {
    const double a = d.x[l] * d.x[l] + d.y[l] * d.y[l] + d.z[l] * d.z[l];
    const double nearest = -(o.x[l] * d.x[l] + o.y[l] * d.y[l] + o.z[l] * d.z[l]) / a;
    // Uses the ray's closest point to the centre, which avoids cancellation far away from a small sphere.
    const double x = o.x[l] + nearest * d.x[l];
    const double y = o.y[l] + nearest * d.y[l];
    const double z = o.z[l] + nearest * d.z[l];
    const double rest = radius * radius - (x * x + y * y + z * z);
    const double half = std::sqrt((rest > 0.0 ? rest : 0.0) / a);
    const double crossing = first_crossing(nearest - half, nearest + half);
    const double hit = rest >= 0.0 ? crossing : kNoHit;
    t[l] = hit;
    const double at = hit < kNoHit ? hit : 0.0;
    n.x[l] = (o.x[l] + at * d.x[l]) / radius;
    n.y[l] = (o.y[l] + at * d.y[l]) / radius;
    n.z[l] = (o.z[l] + at * d.z[l]) / radius;
  }
}

SENSOR_RT_MULTIVERSION
void intersect_box(double hx, double hy, double hz, const Lanes3& __restrict o, const Lanes3& __restrict d,
                   double* __restrict t, Lanes3& __restrict n) {
  for (int l = 0; l < kLanes; ++l) {
    const double ix = safe_reciprocal(d.x[l]);
    const double iy = safe_reciprocal(d.y[l]);
    const double iz = safe_reciprocal(d.z[l]);
    const double x0 = (-std::copysign(hx, ix) - o.x[l]) * ix;
    const double x1 = (std::copysign(hx, ix) - o.x[l]) * ix;
    const double y0 = (-std::copysign(hy, iy) - o.y[l]) * iy;
    const double y1 = (std::copysign(hy, iy) - o.y[l]) * iy;
    const double z0 = (-std::copysign(hz, iz) - o.z[l]) * iz;
    const double z1 = (std::copysign(hz, iz) - o.z[l]) * iz;
    const double enter_xy = x0 > y0 ? x0 : y0;
    const double enter = enter_xy > z0 ? enter_xy : z0;
    const double leave_xy = x1 < y1 ? x1 : y1;
    const double leave = leave_xy < z1 ? leave_xy : z1;
    const double hit = first_crossing(enter, leave);
    t[l] = hit;
    // The face crossed last on entering, or first on leaving.
    const bool inside = !(enter > 0.0);
    const double sign = inside ? 1.0 : -1.0;
    const double edge_x = inside ? x1 : x0;
    const double edge_y = inside ? y1 : y0;
    const double edge = inside ? leave : enter;
    const double on_x = edge_x == edge ? 1.0 : 0.0;
    const double on_y = (1.0 - on_x) * (edge_y == edge ? 1.0 : 0.0);
    n.x[l] = on_x * std::copysign(1.0, sign * ix);
    n.y[l] = on_y * std::copysign(1.0, sign * iy);
    n.z[l] = (1.0 - on_x) * (1.0 - on_y) * std::copysign(1.0, sign * iz);
  }
}

/// Interval of the parameter of a ray; empty if enter > leave.
struct Span {
  double enter;
  double leave;
};

/// Returns where the ray o + t d is inside the cone of radius `middle + slope * z` about z; not where that
/// radius is negative, unless the whole interval is. Roots of a quadratic without cancellation: Press et al.,
/// Numerical Recipes, 3rd ed., section 5.6.
[[gnu::always_inline]] inline Span inside_cone(double middle, double slope, double ox, double oy, double oz,
                                               double dx, double dy, double dz) {
  const double radius = middle + slope * oz;
  const double growth = slope * dz;
  const double a = dx * dx + dy * dy - growth * growth;
  const double b = ox * dx + oy * dy - radius * growth;
  const double c = ox * ox + oy * oy - radius * radius;
  const double discriminant = b * b - a * c;
  const double q = -(b + std::copysign(std::sqrt(discriminant > 0.0 ? discriminant : 0.0), b));
  const double one = q / (a + std::copysign(1e-300, a));
  const double other = q != 0.0 ? c / q : one;
  const double low = one < other ? one : other;
  const double high = one < other ? other : one;
  // A ray steeper than the cone crosses both nappes and stays inside after, or before, the crossing with the
  // nappe of positive radius.
  const bool is_steep = a < 0.0;
  const bool is_along_axis = (a == 0.0) & (b == 0.0);
  const bool misses = (!is_steep & (discriminant < 0.0)) | (is_along_axis & (c > 0.0));
  const double enter = is_steep ? (growth > 0.0 ? high : -kNoHit) : low;
  const double leave = is_steep ? (growth > 0.0 ? kNoHit : low) : high;
  return {misses ? kNoHit : (is_along_axis ? -kNoHit : enter),
          misses ? -kNoHit : (is_along_axis ? kNoHit : leave)};
}

/// Solid of revolution: a cone frustum or cylinder with end faces, with or without a bore through it. Inlined
/// into its callers, which are compiled for several instruction sets.
template <bool kHasBore>
[[gnu::always_inline]] inline void intersect_frustum(const Frustum& shape, const Lanes3& __restrict o,
                                                     const Lanes3& __restrict d, double* __restrict t,
                                                     Lanes3& __restrict n) {
  const double middle = shape.middle_radius;
  const double slope = shape.slope;
  const double bore = shape.bore_radius;
  const double half = shape.half_height;
  const double tilt = 1.0 / std::sqrt(1.0 + slope * slope);
  for (int l = 0; l < kLanes; ++l) {
    // Uses the ray's closest point to the centre, which avoids cancellation far away from a small solid.
    const double length2 = d.x[l] * d.x[l] + d.y[l] * d.y[l] + d.z[l] * d.z[l];
    const double start = -(o.x[l] * d.x[l] + o.y[l] * d.y[l] + o.z[l] * d.z[l]) / length2;
    const double x = o.x[l] + start * d.x[l];
    const double y = o.y[l] + start * d.y[l];
    const double z = o.z[l] + start * d.z[l];
    const Span side = inside_cone(middle, slope, x, y, z, d.x[l], d.y[l], d.z[l]);
    const double iz = safe_reciprocal(d.z[l]);
    const double cap_in = (-std::copysign(half, iz) - o.z[l]) * iz;
    const double cap_out = (std::copysign(half, iz) - o.z[l]) * iz;
    const double side_in = start + side.enter;
    const double side_out = start + side.leave;
    const double enter = side_in > cap_in ? side_in : cap_in;
    const double leave = side_out < cap_out ? side_out : cap_out;
    double hit = first_crossing(enter, leave);
    double on_bore = 0.0;
    if constexpr (kHasBore) {
      const Span hole = inside_cone(bore, 0.0, x, y, z, d.x[l], d.y[l], d.z[l]);
      const double hole_in = start + hole.enter;
      const double hole_out = start + hole.leave;
      const double before = first_crossing(enter, leave < hole_in ? leave : hole_in);
      const double behind = first_crossing(enter > hole_out ? enter : hole_out, leave);
      hit = before < behind ? before : behind;
      on_bore = (hit == hole_in) | (hit == hole_out) ? 1.0 : 0.0;
    }
    t[l] = hit;
    const double on_cap_in = hit == cap_in ? 1.0 : 0.0;
    const double on_cap_out = (1.0 - on_cap_in) * (hit == cap_out ? 1.0 : 0.0);
    const double on_side = (1.0 - on_cap_in) * (1.0 - on_cap_out);
    const double at = hit < kNoHit ? hit : 0.0;
    const double px = o.x[l] + at * d.x[l];
    const double py = o.y[l] + at * d.y[l];
    const double radius = std::sqrt(px * px + py * py);
    const double is_apex = radius > 0.0 ? 0.0 : 1.0;
    const double across = on_side * (on_bore > 0.0 ? -1.0 : tilt) / (radius + is_apex);
    const double along = (1.0 - on_bore) * (is_apex > 0.0 ? std::copysign(1.0, -slope) : -slope * tilt);
    n.x[l] = across * px;
    n.y[l] = across * py;
    n.z[l] = on_side * along + (on_cap_out - on_cap_in) * std::copysign(1.0, iz);
  }
}

SENSOR_RT_MULTIVERSION
void intersect_unbored(const Frustum& shape, const Lanes3& o, const Lanes3& d, double* t, Lanes3& n) {
  intersect_frustum<false>(shape, o, d, t, n);
}

SENSOR_RT_MULTIVERSION
void intersect_bored(const Frustum& shape, const Lanes3& o, const Lanes3& d, double* t, Lanes3& n) {
  intersect_frustum<true>(shape, o, d, t, n);
}

SENSOR_RT_MULTIVERSION
void intersect_rectangle(double hx, double hy, const Lanes3& __restrict o, const Lanes3& __restrict d,
                         double* __restrict t, Lanes3& __restrict n) {
  for (int l = 0; l < kLanes; ++l) {
    const double hit = -o.z[l] * safe_reciprocal(d.z[l]);
    const double x = o.x[l] + hit * d.x[l];
    const double y = o.y[l] + hit * d.y[l];
    t[l] = (hit > 0.0) & (std::abs(x) <= hx) & (std::abs(y) <= hy) ? hit : kNoHit;
    n.x[l] = 0.0;
    n.y[l] = 0.0;
    n.z[l] = 1.0;
  }
}

}  // namespace

void intersect_primitive(const Shape& shape, const Lanes3& origin, const Lanes3& direction, double* t,
                         Lanes3& normal) {
  const Eigen::Vector3d& h = shape.half_size;
  switch (shape.kind) {
    case ShapeKind::kSphere:
      return intersect_sphere(h.x(), origin, direction, t, normal);
    case ShapeKind::kBox:
      return intersect_box(h.x(), h.y(), h.z(), origin, direction, t, normal);
    case ShapeKind::kFrustum:
      return shape.frustum.bore_radius > 0.0 ? intersect_bored(shape.frustum, origin, direction, t, normal)
                                             : intersect_unbored(shape.frustum, origin, direction, t, normal);
    case ShapeKind::kRectangle:
      return intersect_rectangle(h.x(), h.y(), origin, direction, t, normal);
    case ShapeKind::kMesh:
      break;
  }
}

}  // namespace sensor_rt
