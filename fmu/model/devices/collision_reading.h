// Outputs of the collision monitor.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fmu/model/fields.h"

namespace robotcell {

/// A colliding pair of bodies.
struct PairCollision {
  std::int32_t pair = 0;          // zero-based, in the order of the description
  double depth = 0;               // m
  std::array<double, 3> point{};  // m, world, the deepest one
  double least_depth = 0;         // m, since the collision began or was last reported as deeper

  template <class Visitor>
  static void declare(Visitor& visit, PairCollision& c) {
    visit(c, state(c.pair, "pair"), state(c.depth, "depth"), state(c.point, "point"),
          state(c.least_depth, "least_depth"));
  }
};

/// Bodies are numbered in the order of the description, from 1; 0: none.
struct CollisionReading {
  std::int32_t pairs = 0;  // number of colliding pairs
  std::int32_t body_a = 0, body_b = 0;
  double depth = 0;               // m, of the deepest collision
  std::array<double, 3> point{};  // m, world
  double clearance = 0;           // m, smallest distance; the range where all distances exceed it
  std::int32_t near_a = 0, near_b = 0;
  std::array<std::int32_t, 2> near_faces{};  // internal: closest faces, from which the next search starts
  bool begins = false;                       // internal: a pair collides that did not at the cycle before
  bool deepens = false;                      // internal: a pair has become deeper
  std::vector<PairCollision> colliding;      // internal: at the last cycle
  std::vector<PairCollision> passed;         // internal: since then, of pairs that did not collide there

  /// {} is replaced by the numbers of the bodies.
  template <class Visitor>
  static void declare(Visitor& visit, CollisionReading& r) {
    visit(
        r,
        field(r.pairs,
              bounded(
                  {"truth.collision.pairs", kNone,
                   "Number of monitored pairs of bodies that collide at the last controller cycle, or have "
                   "collided between it and the cycle before: their surfaces intersect, or one body encloses "
                   "the other"},
                  0)),
        field(r.body_a,
              bounded({"truth.collision.body_a", kNone, "First body of the deepest collision{}"}, 0)),
        field(r.body_b,
              bounded({"truth.collision.body_b", kNone, "Second body of the deepest collision{}"}, 0)),
        field(r.depth, bounded({"truth.collision.depth", kMetre,
                                "Penetration depth of the deepest collision at the last controller cycle"},
                               0)),
        field(r.point, {"truth.collision.point[{i}]", kMetre,
                        "Deepest point of the deepest collision: {x} in the world frame"}),
        field(
            r.clearance,
            initially(
                Initial::kDescription,
                bounded({"truth.clearance.distance", kMetre,
                         "Smallest distance of all monitored pairs of bodies, 0 during a collision, at most "
                         "the collision range of the description at the last controller cycle"},
                        0))),
        field(r.near_a, bounded({"truth.clearance.body_a", kNone, "First body of the closest pair{}"}, 0)),
        field(r.near_b, bounded({"truth.clearance.body_b", kNone, "Second body of the closest pair{}"}, 0)),
        state(r.near_faces, "near_faces"), state(r.begins, "begins"), state(r.deepens, "deepens"),
        state(r.colliding, "colliding"), state(r.passed, "passed"));
  }
};

}  // namespace robotcell
