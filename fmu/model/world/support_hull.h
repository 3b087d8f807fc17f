// Convex hulls with a limited number of faces.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "fmu/model/description/hull.h"

namespace robotcell {

/// A hull of at most about 230 faces inside a convex hull, spanned by some of its vertices: the extreme
/// points in evenly distributed directions, and the corners of the lowest face along `up`, on which the body
/// stands.
///
/// The collision detector stops after 250 contacts: a base of several hundred triangles would be supported on
/// one side only. Throws std::invalid_argument when the vertices span no volume.
Hull support_hull(const std::vector<Eigen::Vector3d>& vertices, const Eigen::Vector3d& up);

}  // namespace robotcell
