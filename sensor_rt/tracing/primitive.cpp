#include "sensor_rt/tracing/primitive.h"

#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

// Conditions are combined by & and applied as factors: the loops vectorise only without branches.

constexpr double kNone = std::numeric_limits<double>::infinity();

/// Returns a finite reciprocal of a direction component, so that 0 * infinity never occurs.
inline double safe_reciprocal(double d) { return 1.0 / (d + std::copysign(1e-200, d)); }

/// Returns the first positive end of the interval [enter, leave] in which a ray is inside a convex solid.
inline double first_crossing(double enter, double leave) {
  const double first = enter > 0.0 ? enter : leave;
  return (enter <= leave) & (leave > 0.0) ? first : kNone;
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
    const double hit = rest >= 0.0 ? crossing : kNone;
    t[l] = hit;
    const double at = hit < kNone ? hit : 0.0;
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

SENSOR_RT_MULTIVERSION
void intersect_cylinder(double radius, double half, const Lanes3& __restrict o, const Lanes3& __restrict d,
                        double* __restrict t, Lanes3& __restrict n) {
  for (int l = 0; l < kLanes; ++l) {
    const double a = d.x[l] * d.x[l] + d.y[l] * d.y[l];
    const double inverse =
        1.0 /
        (a +
         1e-300);  // a ray along the axis never leaves through the side: its intersection is very far away
    const double nearest = -(o.x[l] * d.x[l] + o.y[l] * d.y[l]) * inverse;
    const double x = o.x[l] + nearest * d.x[l];
    const double y = o.y[l] + nearest * d.y[l];
    const double rest = radius * radius - (x * x + y * y);
    const double reach = std::sqrt((rest > 0.0 ? rest : 0.0) * inverse);
    const double iz = safe_reciprocal(d.z[l]);
    const double cap_in = (-std::copysign(half, iz) - o.z[l]) * iz;
    const double cap_out = (std::copysign(half, iz) - o.z[l]) * iz;
    const double side_in = nearest - reach;
    const double side_out = nearest + reach;
    const double enter = side_in > cap_in ? side_in : cap_in;
    const double leave = side_out < cap_out ? side_out : cap_out;
    const double crossing = first_crossing(enter, leave);
    const double hit = rest >= 0.0 ? crossing : kNone;
    t[l] = hit;
    const bool inside = !(enter > 0.0);
    const double sign = inside ? 1.0 : -1.0;
    const double on_cap = (inside ? cap_out : cap_in) == (inside ? leave : enter) ? 1.0 : 0.0;
    const double at = hit < kNone ? hit : 0.0;
    n.x[l] = (1.0 - on_cap) * (o.x[l] + at * d.x[l]) / radius;
    n.y[l] = (1.0 - on_cap) * (o.y[l] + at * d.y[l]) / radius;
    n.z[l] = on_cap * std::copysign(1.0, sign * iz);
  }
}

SENSOR_RT_MULTIVERSION
void intersect_rectangle(double hx, double hy, const Lanes3& __restrict o, const Lanes3& __restrict d,
                         double* __restrict t, Lanes3& __restrict n) {
  for (int l = 0; l < kLanes; ++l) {
    const double hit = -o.z[l] * safe_reciprocal(d.z[l]);
    const double x = o.x[l] + hit * d.x[l];
    const double y = o.y[l] + hit * d.y[l];
    t[l] = (hit > 0.0) & (std::abs(x) <= hx) & (std::abs(y) <= hy) ? hit : kNone;
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
    case ShapeKind::kCylinder:
      return intersect_cylinder(h.x(), h.z(), origin, direction, t, normal);
    case ShapeKind::kRectangle:
      return intersect_rectangle(h.x(), h.y(), origin, direction, t, normal);
    case ShapeKind::kMesh:
      break;
  }
}

}  // namespace sensor_rt
