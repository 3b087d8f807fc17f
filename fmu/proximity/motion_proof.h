// Proof that motions keep clearances: distances and bounds on the motion, bisected.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "fmu/proximity/cell_motion.h"
#include "fmu/proximity/pair_distances.h"
#include "fmu/proximity/pair_search.h"

namespace robotcell::proximity {

/// Motions that are linear in the axes; arrays are row-major.
struct Motions {
  const double* start = nullptr;      // (count, axes), rad
  const double* end = nullptr;        // (count, axes), rad
  const double* deviation = nullptr;  // (count, axes), rad: of the true motion from the straight one
  const double* required = nullptr;   // (count, pairs) clearance, m; -inf: the pair is not checked
  std::size_t count = 0;
  double finest = 0;  // rad from the middle of an interval to its ends: what is not proved there violates
};

/// What searches found out about each pair, and the work that they did.
struct ProofMemory {
  PairSearch search;
  std::vector<PairMemory> pairs;
};

struct FirstClash {
  std::int64_t pair = -1;  // -1: the motion keeps all clearances
  double distance = 0;     // m
  double fraction = 0;     // of the motion
};

/// Work of the searches, see `PairSearch::work`, after which nothing more is proved.
constexpr std::size_t kUnlimited = std::numeric_limits<std::size_t>::max();

/// At the middle of an interval of a motion, a pair of bodies at distance d keeps the clearance c in the
/// whole interval if d >= c + h, where h bounds the motion of one body relative to the other from the middle
/// to either end (Schwarzer, Saha & Latombe, "Exact collision checking of robot paths", 2002). Bounding
/// volumes and faces need room only for their own motion along the direction that separates them, to first
/// order. Intervals without this proof are halved.
class MotionProof {
 public:
  /// The bodies and pairs of the motion are those of the scene, which must outlive the proof.
  MotionProof(const PairDistances& scene, CellMotion motion);

  const CellMotion& motion() const { return motion_; }

  /// A point (count,) of each motion that violates a clearance, if it is not proved to keep all. It is the
  /// first one on the motion among those of the coarsest intervals. Threads do not change the result.
  void first_clashes(const Motions& motions, unsigned threads, FirstClash* found) const;

  /// Whether each pair (pairs,) is not proved to keep its clearance on motions that follow each other, which
  /// have the same clearances. Returns the work. The memory of earlier calls shortens it; so they must not
  /// run in parallel.
  std::size_t violations(const Motions& motions, std::size_t budget, bool* violated);

  /// Where on such motions each pair (pairs,) is first not proved to keep its clearance:
  /// the beginning of one of `parts` (a power of 2) equal parts of a motion, counted in motions; infinite for
  /// pairs that keep it, and for those that are not the first. Returns the work.
  std::size_t first_violations(const Motions& motions, std::size_t parts, std::size_t budget, double* first);

  /// Distances (count, pairs), m, at `axes` (count, axes), rad, of some of the pairs; NaN of the others.
  /// Returns the work.
  std::size_t distances(const double* axes, std::size_t count, const bool* wanted, double* distances);

 private:
  const PairDistances& scene_;
  CellMotion motion_;
  ProofMemory memory_;
};

}  // namespace robotcell::proximity
