#include "fmu/proximity/bindings/motion_bindings.h"

#include <cmath>
#include <memory>
#include <string>

#include "fmu/proximity/bindings/arrays.h"
#include "fmu/proximity/motion_proof.h"

namespace robotcell::proximity {
namespace {

using Eigen::Isometry3d;
using RowMajor4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

// Kind (0 fixed, 1 revolute, 2 prismatic), parent, axis, parent_from_joint (4, 4), joint_from_frame (4, 4).
constexpr py::ssize_t kJointColumns = 35;
// Frame, centre, radius, distance from the axis, frame_from_body (4, 4).
constexpr py::ssize_t kBodyColumns = 22;

Isometry3d to_pose(const double* row_major) {
  Isometry3d pose;
  pose.matrix() = Eigen::Map<const RowMajor4>(row_major);
  return pose;
}

/// A whole number from `first` to below `end`, counted from there.
std::size_t whole(double value, double first, std::size_t end, const char* name) {
  if (!(value >= first && value < static_cast<double>(end) && value == std::floor(value))) {
    throw std::invalid_argument(std::string(name) + ": unexpected number " + std::to_string(value));
  }
  return static_cast<std::size_t>(value - first);
}

/// The rows do not hold the world: as a parent or frame it has the number -1.
Tree to_tree(const Doubles& rows, std::size_t axes) {
  require_shape(rows, "joints", {-1, kJointColumns});
  Tree tree;
  for (py::ssize_t i = 0; i < rows.shape(0); ++i) {
    const double* row = rows.data(i, 0);
    const auto kind = static_cast<Joint::Kind>(whole(row[0], 0, 3, "joints: kind"));
    const bool moves = kind != Joint::Kind::kFixed;
    tree.add({kind, whole(row[1], -1, static_cast<std::size_t>(i), "joints: parent"),
              moves ? whole(row[2], 0, axes, "joints: axis") : 0, to_pose(row + 3), to_pose(row + 19)});
  }
  return tree;
}

std::unique_ptr<CellMotion> make_motion(const Doubles& joints, std::size_t axes, const Doubles& bodies,
                                        const py::object& pairs) {
  Tree tree = to_tree(joints, axes);
  require_shape(bodies, "bodies", {-1, kBodyColumns});
  std::vector<CarriedBody> carried;
  for (py::ssize_t i = 0; i < bodies.shape(0); ++i) {
    const double* row = bodies.data(i, 0);
    carried.push_back({whole(row[0], -1, tree.size() - 1, "bodies: frame"), to_pose(row + 6),
                       Eigen::Map<const Eigen::Vector3d>(row + 1), row[4], row[5]});
  }
  const auto numbers = to_pairs(pairs);
  for (const auto& [a, b] : numbers) {
    if (std::max(a, b) >= carried.size()) throw std::invalid_argument("pairs: expected numbers of bodies");
  }
  return std::make_unique<CellMotion>(std::move(tree), axes, std::move(carried), numbers);
}

py::array_t<double> bounds(const CellMotion& motion, const Doubles& at, const Doubles& half,
                           const Doubles& slack) {
  const auto axes = static_cast<py::ssize_t>(motion.axes());
  const auto pairs = static_cast<py::ssize_t>(motion.pairs());
  require_shape(at, "at", {-1, axes});
  require_shape(half, "half", {at.shape(0), axes});
  require_shape(slack, "slack", {at.shape(0), axes});
  py::array_t<double> result({at.shape(0), pairs});
  CellFrames frames;
  for (py::ssize_t i = 0; i < at.shape(0); ++i) {
    motion.place(at.data(i, 0), frames);
    for (py::ssize_t k = 0; k < pairs; ++k) {
      *result.mutable_data(i, k) =
          motion.motion(frames, static_cast<std::size_t>(k), half.data(i, 0), slack.data(i, 0)).bound;
    }
  }
  return result;
}

py::tuple tool_poses(const CellMotion& motion, const Doubles& axes, int frame,
                     const Doubles& frame_from_tool) {
  const auto count = static_cast<py::ssize_t>(motion.axes());
  require_shape(axes, "axes", {-1, count});
  require_shape(frame_from_tool, "frame_from_tool", {4, 4});
  const auto number = static_cast<std::size_t>(frame + 1);
  py::array_t<double> poses({axes.shape(0), py::ssize_t{4}, py::ssize_t{4}});
  py::array_t<double> jacobians({axes.shape(0), py::ssize_t{6}, count});
  Eigen::Matrix<double, 6, Eigen::Dynamic> jacobian;
  for (py::ssize_t i = 0; i < axes.shape(0); ++i) {
    const Isometry3d tool =
        motion.place_tool(axes.data(i, 0), number, to_pose(frame_from_tool.data()), jacobian);
    Eigen::Map<RowMajor4>(poses.mutable_data(i, 0, 0)) = tool.matrix();
    Eigen::Map<Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::RowMajor>>(jacobians.mutable_data(i, 0, 0), 6,
                                                                          count) = jacobian;
  }
  return py::make_tuple(poses, jacobians);
}

Motions to_motions(const MotionProof& proof, const Doubles& start, const Doubles& end,
                   const Doubles& deviation, const Doubles& required, double finest) {
  const auto axes = static_cast<py::ssize_t>(proof.motion().axes());
  const py::ssize_t count = start.ndim() > 0 ? start.shape(0) : 0;
  require_shape(start, "start", {-1, axes});
  require_shape(end, "end", {count, axes});
  require_shape(deviation, "deviation", {count, axes});
  require_shape(required, "required", {count, static_cast<py::ssize_t>(proof.motion().pairs())});
  if (!(finest > 0)) throw std::invalid_argument("finest: expected an angle above 0");
  for (const Doubles* array : {&start, &end, &deviation}) {
    for (py::ssize_t i = 0; i < array->size(); ++i) {
      if (!std::isfinite(array->data()[i])) throw std::invalid_argument("motions: expected finite angles");
    }
  }
  for (py::ssize_t i = 0; i < deviation.size(); ++i) {
    if (deviation.data()[i] < 0) throw std::invalid_argument("deviation: expected angles of at least 0");
  }
  for (py::ssize_t i = 0; i < required.size(); ++i) {
    if (std::isnan(required.data()[i])) throw std::invalid_argument("required: expected clearances, got NaN");
  }
  return {start.data(), end.data(), deviation.data(), required.data(), static_cast<std::size_t>(count),
          finest};
}

py::tuple first_clashes(const MotionProof& proof, const Doubles& start, const Doubles& end,
                        const Doubles& deviation, const Doubles& required, double finest, unsigned threads) {
  const Motions motions = to_motions(proof, start, end, deviation, required, finest);
  std::vector<FirstClash> found(motions.count);
  {
    const py::gil_scoped_release release;
    proof.first_clashes(motions, threads, found.data());
  }
  py::list result;
  for (const FirstClash& clash : found) {
    result.append(clash.pair < 0 ? py::object(py::none())
                                 : py::make_tuple(clash.pair, clash.distance, clash.fraction));
  }
  return py::tuple(result);
}

py::tuple violations(MotionProof& proof, const Doubles& start, const Doubles& end, const Doubles& deviation,
                     const Doubles& required, double finest, std::size_t budget) {
  const Motions motions = to_motions(proof, start, end, deviation, required, finest);
  py::array_t<bool> violated(static_cast<py::ssize_t>(proof.motion().pairs()));
  const std::size_t work = proof.violations(motions, budget, violated.mutable_data());
  return py::make_tuple(violated, work);
}

py::tuple first_violations(MotionProof& proof, const Doubles& start, const Doubles& end,
                           const Doubles& deviation, const Doubles& required, double finest,
                           std::size_t parts, std::size_t budget) {
  const Motions motions = to_motions(proof, start, end, deviation, required, finest);
  if (parts == 0 || (parts & (parts - 1)) != 0) throw std::invalid_argument("parts: expected a power of 2");
  py::array_t<double> first(static_cast<py::ssize_t>(proof.motion().pairs()));
  const std::size_t work = proof.first_violations(motions, parts, budget, first.mutable_data());
  return py::make_tuple(first, work);
}

py::tuple distances_of_proof(MotionProof& proof, const Doubles& axes,
                             const py::array_t<bool, py::array::c_style>& pairs) {
  require_shape(axes, "axes", {-1, static_cast<py::ssize_t>(proof.motion().axes())});
  require_shape(pairs, "pairs", {static_cast<py::ssize_t>(proof.motion().pairs())});
  for (py::ssize_t i = 0; i < axes.size(); ++i) {
    if (!std::isfinite(axes.data()[i])) throw std::invalid_argument("axes: expected finite angles");
  }
  py::array_t<double> result({axes.shape(0), pairs.shape(0)});
  const auto count = static_cast<std::size_t>(axes.shape(0));
  const std::size_t work = proof.distances(axes.data(), count, pairs.data(), result.mutable_data());
  return py::make_tuple(result, work);
}

std::unique_ptr<MotionProof> make_proof(const PairDistances& scene, const CellMotion& motion) {
  if (scene.bodies() != motion.bodies() || scene.pairs() != motion.pairs()) {
    throw std::invalid_argument("motion: expected the bodies and pairs of the scene");
  }
  return std::make_unique<MotionProof>(scene, motion);
}

}  // namespace

void bind_motion(py::module_& module) {
  py::class_<CellMotion>(module, "CellMotion", py::module_local())
      .def(py::init(&make_motion), py::arg("joints"), py::arg("axes"), py::arg("bodies"), py::arg("pairs"))
      .def("bounds", &bounds, py::arg("at"), py::arg("half"), py::arg("slack"))
      .def("tool_poses", &tool_poses, py::arg("axes"), py::arg("frame"), py::arg("frame_from_tool"));
  py::class_<MotionProof>(module, "MotionProof", py::module_local())
      .def(py::init(&make_proof), py::arg("scene"), py::arg("motion"), py::keep_alive<1, 2>())
      .def("first_clashes", &first_clashes, py::arg("start"), py::arg("end"), py::arg("deviation"),
           py::arg("required"), py::arg("finest"), py::arg("threads") = 0)
      .def("distances", &distances_of_proof, py::arg("axes"), py::arg("pairs"))
      .def("violations", &violations, py::arg("start"), py::arg("end"), py::arg("deviation"),
           py::arg("required"), py::arg("finest"), py::arg("budget"))
      .def("first_violations", &first_violations, py::arg("start"), py::arg("end"), py::arg("deviation"),
           py::arg("required"), py::arg("finest"), py::arg("parts"), py::arg("budget"));
}

}  // namespace robotcell::proximity
