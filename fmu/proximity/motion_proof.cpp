#include "fmu/proximity/motion_proof.h"

#include <algorithm>
#include <cmath>

#include "fmu/proximity/blocks.h"

namespace robotcell::proximity {
namespace {

/// Motions that one thread takes at a time.
constexpr std::size_t kBlock = 64;

/// Distance (m) beyond the clearance: longer searches cost more than halving the interval.
constexpr double kFarthestSearch = 0.01;

/// Comparisons of the search for a violation where the interval is to be halved anyway.
constexpr std::size_t kProofPatience = 50;

/// Bodies closer than this (m) intersect.
constexpr double kContact = 1e-9;

constexpr double kNone = -std::numeric_limits<double>::infinity();

enum class Verdict { kProved, kOpen, kViolated };

using Pairs = std::vector<std::size_t>;

struct Interval {
  std::size_t motion = 0;
  double middle = 0;  // of the motion
  Pairs pairs;        // not proved yet
};

/// Distance (m) of the bounding spheres of two bodies, below 0 where they intersect.
double spheres_apart(const SearchBody& a, const SearchBody& b, const Eigen::Isometry3d& a_from_b) {
  const BoundingSphere &of_a = a.tree.sphere(0), &of_b = b.tree.sphere(0);
  return (a_from_b * of_b.centre - of_a.centre).norm() - of_a.radius - of_b.radius;
}

/// Judges intervals. What searches find out about a pair carries over to the next interval.
class Judge {
 public:
  Judge(const PairDistances& scene, const CellMotion& motion, const Motions& motions, std::size_t budget,
        ProofMemory& memory)
      : scene_(scene),
        motion_(motion),
        motions_(motions),
        budget_(budget),
        search_(memory.search),
        memory_(memory.pairs),
        dropped_(motion.pairs(), false),
        begin_(memory.search.work()) {
    memory_.resize(motion.pairs());
    for (PairMemory& pair : memory_) {  // of other poses: only the faces are reusable
      pair.at_least = -1;
      pair.enclosure_holds = 0;
      pair.front.clear();
    }
  }

  std::size_t work() const { return search_.work() - begin_; }

  double required(std::size_t motion, std::size_t pair) const {
    return std::max(motions_.required[motion * motion_.pairs() + pair], kContact);
  }

  /// Pairs of a motion that have a clearance.
  Pairs pairs_of(std::size_t motion) const {
    Pairs pairs;
    for (std::size_t pair = 0; pair < motion_.pairs(); ++pair) {
      if (motions_.required[motion * motion_.pairs() + pair] > kNone) pairs.push_back(pair);
    }
    return pairs;
  }

  /// Goes to an interval of a motion, from `middle` by `half` to either side.
  void enter(std::size_t motion, double middle, double half) {
    const std::size_t axes = motion_.axes();
    const double* start = motions_.start + motion * axes;
    const double* end = motions_.end + motion * axes;
    const double* deviation = motions_.deviation + motion * axes;
    number_ = motion;
    at_.resize(axes);
    half_.resize(axes);
    rest_.assign(axes, 0);
    slack_.assign(deviation, deviation + axes);
    finest_ = true;
    for (std::size_t i = 0; i < axes; ++i) {
      at_[i] = start[i] + middle * (end[i] - start[i]);
      half_[i] = half * (end[i] - start[i]);
      finest_ = finest_ && std::abs(half_[i]) < motions_.finest;
    }
    strays_ = std::any_of(slack_.begin(), slack_.end(), [](double angle) { return angle != 0; });
    motion_.place(at_.data(), frames_);
  }

  /// Goes to all motions at once, where the one in the middle begins.
  void enter_all() {
    const std::size_t axes = motion_.axes();
    enter(motions_.count / 2, 0, 0);
    finest_ = false;
    for (std::size_t i = 0; i < axes; ++i) {
      double farthest = 0, strayed = 0;
      for (std::size_t k = 0; k < motions_.count; ++k) {
        strayed = std::max(strayed, motions_.deviation[k * axes + i]);
        for (const double* end : {motions_.start, motions_.end}) {
          farthest = std::max(farthest, std::abs(end[k * axes + i] - at_[i]));
        }
      }
      slack_[i] = farthest + strayed;  // the way bends: it is a deviation from rest
    }
    strays_ = false;
  }

  /// Looks at a pair no more.
  void drop(std::size_t pair) { dropped_[pair] = true; }
  bool is_dropped(std::size_t pair) const { return dropped_[pair]; }

  /// Whether a pair keeps its clearance in the interval.
  Verdict judge(std::size_t pair) {
    if (work() >= budget_) return Verdict::kViolated;
    const RelativeMotion motion = motion_.motion(frames_, pair, half_.data(), slack_.data());
    const double moved = motion.bound;
    const double strayed = strays_ ? motion_.motion(frames_, pair, rest_.data(), slack_.data()).bound : 0;
    const Verdict open = finest_ ? Verdict::kViolated : Verdict::kOpen;
    const double least = required(number_, pair);
    const auto& [a, b] = scene_.pair(pair);
    const Eigen::Isometry3d a_from_b = relative_pose(pair);
    if (moved > kFarthestSearch + strayed) {
      return spheres_apart(scene_.body(a), scene_.body(b), a_from_b) < least + moved ? open
                                                                                     : Verdict::kProved;
    }
    const auto found = search_.near(scene_.body(a), scene_.body(b), a_from_b, least + moved, memory_[pair],
                                    least + strayed, kProofPatience, sweep(motion, a, least));
    if (!found) {
      // Surfaces that keep their distance may be those of a body inside the other one.
      const bool inside =
          search_.encloses(scene_.body(a), scene_.body(b), a_from_b, std::max(least, 0.0), memory_[pair]);
      return inside ? Verdict::kViolated : Verdict::kProved;
    }
    return found->distance < least + strayed ? Verdict::kViolated : open;
  }

  /// Distance (m) of a pair at the middle of the interval.
  double distance(std::size_t pair) {
    const auto& [a, b] = scene_.pair(pair);
    const double infinite = std::numeric_limits<double>::infinity();
    const Eigen::Isometry3d a_from_b = relative_pose(pair);
    const double distance =
        search_.closest(scene_.body(a), scene_.body(b), a_from_b, infinite, memory_[pair])->distance;
    const bool inside = search_.encloses(scene_.body(a), scene_.body(b), a_from_b, distance, memory_[pair]);
    return inside ? 0 : distance;
  }

 private:
  /// A motion relative to body `a`, which is to keep `least` (m).
  Sweep sweep(const RelativeMotion& motion, std::size_t a, double least) const {
    const Eigen::Isometry3d& world_from_a = frames_.bodies[a];
    const Eigen::Matrix3d a_from_world = world_from_a.linear().transpose();
    return {motion.moving == a, a_from_world * (motion.at - world_from_a.translation()),
            a_from_world * motion.velocity, a_from_world * motion.turn, least + motion.rest};
  }

  Eigen::Isometry3d relative_pose(std::size_t pair) const {
    const auto& [a, b] = scene_.pair(pair);
    return frames_.bodies[a].inverse(Eigen::Isometry) * frames_.bodies[b];
  }

  const PairDistances& scene_;
  const CellMotion& motion_;
  const Motions& motions_;
  std::size_t budget_;
  PairSearch& search_;
  std::vector<PairMemory>& memory_;
  std::vector<bool> dropped_;
  std::size_t begin_;  // work before
  CellFrames frames_;
  std::vector<double> at_, half_, slack_, rest_;
  std::size_t number_ = 0;
  bool finest_ = false, strays_ = false;
};

/// Halves intervals level by level. `violated(interval, pairs)` receives those that violate their clearance
/// in an interval, in which the judge is, and returns whether to go on.
template <typename Violated>
void bisect(Judge& judge, std::vector<Interval> intervals, const Violated& violated) {
  Pairs violating;
  for (double half = 0.5; !intervals.empty(); half /= 2) {
    std::vector<Interval> next;
    for (Interval& interval : intervals) {
      judge.enter(interval.motion, interval.middle, half);
      Pairs open;
      violating.clear();
      for (const std::size_t pair : interval.pairs) {
        if (judge.is_dropped(pair)) continue;
        const Verdict verdict = judge.judge(pair);
        if (verdict == Verdict::kOpen) open.push_back(pair);
        if (verdict == Verdict::kViolated) violating.push_back(pair);
      }
      if (!violating.empty() && !violated(interval, violating)) return;
      if (open.empty()) continue;
      next.push_back({interval.motion, interval.middle - half / 2, open});
      next.push_back({interval.motion, interval.middle + half / 2, std::move(open)});
    }
    intervals.swap(next);
  }
}

/// Goes through motions in order and finds where the first pairs are not proved.
class InOrder {
 public:
  InOrder(Judge& judge, double part, double* first) : judge_(judge), part_(part), first_(first) {}

  /// Looks at an interval of a motion.
  void follow(std::size_t motion, double middle, double half, const Pairs& pairs) {
    if (static_cast<double>(motion) + middle - half >= earliest_) return;
    judge_.enter(motion, middle, half);
    const bool is_part = 2 * half <= part_;
    Pairs open, violating;
    for (const std::size_t pair : pairs) {
      if (judge_.is_dropped(pair)) continue;
      const Verdict verdict = judge_.judge(pair);
      if (verdict == Verdict::kProved) continue;
      if (verdict == Verdict::kViolated && is_part) {
        found(pair, static_cast<double>(motion) + part_ * std::floor((middle - half) / part_));
        continue;
      }
      open.push_back(pair);
      if (verdict == Verdict::kViolated) violating.push_back(pair);
    }
    if (open.empty()) return;
    follow(motion, middle - half / 2, half / 2, open);
    for (const std::size_t pair : violating) {
      if (!judge_.is_dropped(pair)) found(pair, static_cast<double>(motion) + middle);
    }
    follow(motion, middle + half / 2, half / 2, open);
  }

 private:
  void found(std::size_t pair, double where) {
    if (where > earliest_) return;
    earliest_ = first_[pair] = where;
    judge_.drop(pair);
  }

  Judge& judge_;
  double part_;
  double* first_;
  double earliest_ = std::numeric_limits<double>::infinity();
};

}  // namespace

MotionProof::MotionProof(const PairDistances& scene, CellMotion motion)
    : scene_(scene), motion_(std::move(motion)) {}

void MotionProof::first_clashes(const Motions& motions, unsigned threads, FirstClash* found) const {
  for_each_block(motions.count, kBlock, threads, [&](std::size_t first, std::size_t last) {
    ProofMemory memory;
    Judge judge(scene_, motion_, motions, kUnlimited, memory);
    for (std::size_t i = first; i < last; ++i) {
      bisect(judge, {{i, 0.5, judge.pairs_of(i)}}, [&](const Interval& interval, const Pairs& pairs) {
        double lack = std::numeric_limits<double>::infinity();
        for (const std::size_t pair : pairs) {
          const double distance = judge.distance(pair);
          if (distance - judge.required(i, pair) >= lack) continue;
          lack = distance - judge.required(i, pair);
          found[i] = {static_cast<std::int64_t>(pair), distance, interval.middle};
        }
        return false;
      });
    }
  });
}

std::size_t MotionProof::violations(const Motions& motions, std::size_t budget, bool* violated) {
  Judge judge(scene_, motion_, motions, budget, memory_);
  std::fill(violated, violated + motion_.pairs(), false);
  Pairs open;
  judge.enter_all();
  for (const std::size_t pair : judge.pairs_of(0)) {
    const Verdict verdict = judge.judge(pair);
    violated[pair] = verdict == Verdict::kViolated;
    if (verdict == Verdict::kOpen) open.push_back(pair);
  }
  if (open.empty()) return judge.work();
  std::vector<Interval> intervals;
  for (std::size_t i = 0; i < motions.count; ++i) intervals.push_back({i, 0.5, open});
  bisect(judge, std::move(intervals), [&](const Interval&, const Pairs& pairs) {
    for (const std::size_t pair : pairs) {
      violated[pair] = true;
      judge.drop(pair);
    }
    return true;
  });
  return judge.work();
}

std::size_t MotionProof::first_violations(const Motions& motions, std::size_t parts, std::size_t budget,
                                          double* first) {
  Judge judge(scene_, motion_, motions, budget, memory_);
  std::fill(first, first + motion_.pairs(), std::numeric_limits<double>::infinity());
  Pairs open;
  judge.enter_all();
  for (const std::size_t pair : judge.pairs_of(0)) {
    if (judge.judge(pair) != Verdict::kProved) open.push_back(pair);
  }
  InOrder in_order(judge, 1.0 / static_cast<double>(parts), first);
  for (std::size_t i = 0; i < motions.count && !open.empty(); ++i) in_order.follow(i, 0.5, 0.5, open);
  return judge.work();
}

std::size_t MotionProof::distances(const double* axes, std::size_t count, const bool* wanted,
                                   double* distances) {
  const std::vector<double> still(count * motion_.axes(), 0);
  const Motions motions{axes, axes, still.data(), nullptr, count, 1};
  Judge judge(scene_, motion_, motions, kUnlimited, memory_);
  for (std::size_t i = 0; i < count; ++i) {
    judge.enter(i, 0, 0);
    for (std::size_t pair = 0; pair < motion_.pairs(); ++pair) {
      distances[i * motion_.pairs() + pair] =
          wanted[pair] ? judge.distance(pair) : std::numeric_limits<double>::quiet_NaN();
    }
  }
  return judge.work();
}

}  // namespace robotcell::proximity
