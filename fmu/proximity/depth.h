// How deep two bodies are in each other.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {

struct Depth {
  double depth = 0;                                 // m
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // the deepest, world
};

/// The greatest distance from the other body's surface among the corners and edges of either body that are
/// inside the other one, where their surfaces intersect. For bodies that touch each other at one place, that
/// is how far they must be moved apart; of bodies far in each other only the rim is looked at.
Depth depth_at(const BodySet::Body& a, const BodySet::Body& b, const std::vector<FacePair>& intersections);

}  // namespace robotcell::proximity
