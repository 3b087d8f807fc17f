#include "sensor_rt/imaging/agreement.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/imaging/triangulate.h"

namespace sensor_rt {
namespace {

constexpr double kStripeNoiseSigmas = 4.0;
constexpr double kNearby = 4.0;      // sum of both stripe widths: nearby, but not at the expected position
constexpr double kTrackJump = 2.0;   // rows per column within a track
constexpr double kNeighbours = 4.0;  // rows to a neighbour two columns away within a track
constexpr double kConfirmedShare = 0.5;  // fraction of confirmed peaks from which a track confirms the others
// A peak distorted by another one is not evidence for or against agreement.
constexpr std::uint32_t kBent = kPeakAsymmetric | kPeakResidual | kPeakOverlap | kPeakWide | kPeakBorder;
constexpr std::uint32_t kNoise = kPeakWeak | kPeakNarrow | kPeakNotConverged;

/// A peak with its point on the sheet.
struct SheetPoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  int bin = -1;          ///< bin of the laser ray; -1: outside the measuring range, or noise
  bool refuted = false;  ///< another camera sees the stripe nearby, but not at this point
};

/// Bins of laser rays by slope, about one column wide, with the cameras that see a peak on them and their
/// confirmed points.
class RayBins {
 public:
  RayBins(const SheetGeometry& geometry, const std::vector<std::vector<SheetPoint>>& sheet_points)
      : source_z_(geometry.source_z) {
    double focal = 1.0;
    for (const Camera& camera : geometry.cameras) focal = std::max(focal, camera.focal_px);
    per_slope_ = focal;
    double highest = -std::numeric_limits<double>::infinity();
    for (const auto& of_camera : sheet_points) {
      for (const SheetPoint& s : of_camera) {
        if (s.bin < 0) continue;
        lowest_ = std::min(lowest_, slope(s.point));
        highest = std::max(highest, slope(s.point));
      }
    }
    const double bins = highest >= lowest_ ? (highest - lowest_) * per_slope_ + 4.0 : 0.0;
    cameras_.assign(static_cast<std::size_t>(std::min(bins, 1e6)), 0u);
    confirmed_.assign(cameras_.size(), {});
  }

  int bin(const Eigen::Vector3d& point) const {
    const double position = (slope(point) - lowest_) * per_slope_ + 1.0;
    return static_cast<int>(std::clamp(position, 0.0, static_cast<double>(cameras_.size()) - 1.0));
  }

  void add(int bin, std::size_t camera) { cameras_[static_cast<std::size_t>(bin)] |= 1u << camera; }
  void add_confirmed(int bin, double z) { confirmed_[static_cast<std::size_t>(bin)].add(z); }

  /// Returns the cameras with a peak on the ray or its neighbours; one bit per camera.
  unsigned cameras(int bin) const {
    unsigned found = 0;
    visit(bin, [&](std::size_t b) { found |= cameras_[b]; });
    return found;
  }

  /// Returns true when the ray or its neighbours have a confirmed point further than `near` from depth z.
  bool has_confirmed_elsewhere(int bin, double z, double near) const {
    bool elsewhere = false;
    visit(bin, [&](std::size_t b) { elsewhere = elsewhere || confirmed_[b].reaches_beyond(z, near); });
    return elsewhere;
  }

 private:
  /// Depth range of the confirmed points of a bin.
  struct Depths {
    double least = std::numeric_limits<double>::infinity();
    double most = -std::numeric_limits<double>::infinity();

    void add(double z) {
      least = std::min(least, z);
      most = std::max(most, z);
    }
    bool reaches_beyond(double z, double near) const {
      return least <= most && (least < z - near || most > z + near);
    }
  };

  double slope(const Eigen::Vector3d& point) const { return point.y() / (point.z() - source_z_); }

  template <typename Body>
  void visit(int bin, const Body& body) const {
    const int last = std::min(bin + 1, static_cast<int>(cameras_.size()) - 1);
    for (int b = std::max(0, bin - 1); b <= last; ++b) body(static_cast<std::size_t>(b));
  }

  double source_z_;
  double per_slope_ = 1.0;
  double lowest_ = std::numeric_limits<double>::infinity();
  std::vector<unsigned> cameras_;
  std::vector<Depths> confirmed_;
};

class Comparison {
 public:
  Comparison(std::vector<CameraPeaks>& peaks, const SheetGeometry& geometry, double tolerance_px)
      : peaks_(peaks), geometry_(geometry), tolerance_(tolerance_px) {
    for (CameraPeaks& of_camera : peaks_) {
      of_camera.agreement.assign(of_camera.fits.size(), CameraAgreement::kContradicted);
      camera_from_sensor_.push_back(camera(of_camera).sensor_from_camera.inverse());
      starts_.push_back(starts(of_camera));
      sheet_points_.push_back(locate(of_camera));
    }
  }

  void run() {
    for (std::size_t a = 0; a < peaks_.size(); ++a) {
      for (std::size_t i = 0; i < sheet_points_[a].size(); ++i) confirm(a, i);
    }
    RayBins rays(geometry_, sheet_points_);
    for (std::size_t a = 0; a < peaks_.size(); ++a) fill_bins(a, rays);
    for (std::size_t a = 0; a < peaks_.size(); ++a) {
      const std::vector<bool> on_confirmed_track = find_confirmed_tracks(a);
      for (std::size_t i = 0; i < sheet_points_[a].size(); ++i) decide(a, i, on_confirmed_track[i], rays);
    }
  }

 private:
  const Camera& camera(const CameraPeaks& p) const {
    return geometry_.cameras[static_cast<std::size_t>(p.camera)];
  }

  /// Number of candidates in the columns before each column.
  std::vector<std::size_t> starts(const CameraPeaks& p) const {
    std::vector<std::size_t> first(static_cast<std::size_t>(camera(p).width_px) + 1, 0);
    for (const Candidate& c : p.candidates) ++first[static_cast<std::size_t>(c.column) + 1];
    for (std::size_t x = 1; x < first.size(); ++x) first[x] += first[x - 1];
    return first;
  }

  std::vector<SheetPoint> locate(const CameraPeaks& p) const {
    std::vector<SheetPoint> found(p.fits.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
      found[i].point = triangulate_exact(camera(p), geometry_.sheet, {p.candidates[i].column, p.fits[i].row});
      const double z = found[i].point.z();
      const bool possible = z >= geometry_.near && z <= geometry_.far && z > geometry_.source_z;
      found[i].bin = possible && (p.fits[i].flags & kNoise) == 0 ? 0 : -1;
    }
    return found;
  }

  Eigen::Vector2d project(std::size_t b, const Eigen::Vector3d& point) const {
    return camera(peaks_[b]).project(camera_from_sensor_[b] * point);
  }

  bool in_view(std::size_t b, const Eigen::Vector2d& pixel) const {
    const Camera& c = camera(peaks_[b]);
    return pixel.x() >= 0.0 && pixel.y() >= 0.0 && pixel.x() <= c.width_px - 1.0 &&
           pixel.y() <= c.height_px - 1.0;
  }

  /// Searches for the point of peak i of camera a in the images of the other cameras.
  void confirm(std::size_t a, std::size_t i) {
    SheetPoint& s = sheet_points_[a][i];
    if (s.bin < 0) return;
    for (std::size_t b = 0; b < peaks_.size(); ++b) {
      if (b == a) continue;
      const Eigen::Vector2d seen = project(b, s.point);
      if (!in_view(b, seen)) continue;
      // Most peaks agree without the tolerance for noise, which is more expensive.
      Match match = nearest(b, seen, 0.0);
      if (match.beyond_tolerance > 0.0) match = nearest(b, seen, transferred_sigma(a, i, b, seen));
      if (match.beyond_tolerance <= 0.0) {
        peaks_[a].agreement[i] = CameraAgreement::kConfirmed;
      } else if ((match.flags & kBent) == 0 &&
                 match.distance < kNearby * (static_cast<double>(peaks_[a].fits[i].width) + match.width)) {
        s.refuted = true;
      }
    }
  }

  /// Returns the standard deviation of peak i of camera a in rows of camera b, which sees its point at
  /// `seen`.
  double transferred_sigma(std::size_t a, std::size_t i, std::size_t b, const Eigen::Vector2d& seen) const {
    const StripeFit& fit = peaks_[a].fits[i];
    const Eigen::Vector3d shifted =
        triangulate_exact(camera(peaks_[a]), geometry_.sheet,
                          {peaks_[a].candidates[i].column, fit.row + static_cast<double>(fit.row_sigma)});
    return std::fabs(project(b, shifted).y() - seen.y());
  }

  /// Finds the peak of camera b closest to an expected position.
  struct Match {
    double beyond_tolerance = std::numeric_limits<double>::infinity();  ///< px; <= 0: agrees
    double distance = std::numeric_limits<double>::infinity();          ///< px
    double width = 0.0;                                                 ///< px
    std::uint32_t flags = 0;
  };

  Match nearest(std::size_t b, const Eigen::Vector2d& seen, double sigma) const {
    const auto left = static_cast<std::size_t>(seen.x());
    const double share = seen.x() - static_cast<double>(left);
    const std::vector<std::size_t>& first = starts_[b];
    const std::size_t right = std::min(left + 1, first.size() - 2);
    Match best;
    const auto offer = [&](double row, double spread, const StripeFit& fit, double slack) {
      const double distance = std::fabs(row - seen.y());
      const double beyond = distance - tolerance_ - slack - kStripeNoiseSigmas * std::hypot(sigma, spread);
      if (beyond >= best.beyond_tolerance) return;
      best = {beyond, distance, static_cast<double>(fit.width), fit.flags};
    };
    for (std::size_t i = first[left]; i < first[left + 1]; ++i) {
      if (sheet_points_[b][i].bin < 0) continue;
      const StripeFit& l = peaks_[b].fits[i];
      const auto spread = static_cast<double>(l.row_sigma);
      bool continued = false;
      for (std::size_t j = first[right]; j < first[right + 1]; ++j) {
        const StripeFit& r = peaks_[b].fits[j];
        if (sheet_points_[b][j].bin < 0 || std::fabs(r.row - l.row) > kTrackJump) continue;
        offer((1.0 - share) * l.row + share * r.row, spread, l, 0.0);
        continued = true;
      }
      if (!continued) offer(l.row, spread, l, share * tolerance_);
    }
    for (std::size_t j = first[right]; j < first[right + 1]; ++j) {
      if (sheet_points_[b][j].bin < 0) continue;
      const StripeFit& r = peaks_[b].fits[j];
      offer(r.row, static_cast<double>(r.row_sigma), r, 0.0);
    }
    return best;
  }

  void fill_bins(std::size_t a, RayBins& rays) {
    for (std::size_t i = 0; i < sheet_points_[a].size(); ++i) {
      SheetPoint& s = sheet_points_[a][i];
      if (s.bin < 0) continue;
      s.bin = rays.bin(s.point);
      rays.add(s.bin, a);
      if (peaks_[a].agreement[i] == CameraAgreement::kConfirmed) rays.add_confirmed(s.bin, s.point.z());
    }
  }

  /// Returns which peaks of camera a lie on a track that is mostly confirmed.
  std::vector<bool> find_confirmed_tracks(std::size_t a) const {
    const CameraPeaks& p = peaks_[a];
    const std::size_t count = p.fits.size();
    std::vector<std::size_t> track(count);
    std::vector<std::size_t> members;
    std::vector<std::size_t> confirmed;
    for (std::size_t i = 0; i < count; ++i) {
      track[i] = predecessor(a, i, track, members.size());
      if (track[i] == members.size()) {
        members.push_back(0);
        confirmed.push_back(0);
      }
      ++members[track[i]];
      if (p.agreement[i] == CameraAgreement::kConfirmed) ++confirmed[track[i]];
    }
    std::vector<bool> on_confirmed_track(count);
    for (std::size_t i = 0; i < count; ++i) {
      on_confirmed_track[i] = static_cast<double>(confirmed[track[i]]) >=
                              kConfirmedShare * static_cast<double>(members[track[i]]);
    }
    return on_confirmed_track;
  }

  /// Returns the track of the nearest peak in the previous column, or a new one.
  std::size_t predecessor(std::size_t a, std::size_t i, const std::vector<std::size_t>& track,
                          std::size_t fresh) const {
    const CameraPeaks& p = peaks_[a];
    const int column = p.candidates[i].column;
    if (column == 0) return fresh;
    const std::vector<std::size_t>& first = starts_[a];
    double nearest = kTrackJump;
    std::size_t found = fresh;
    for (std::size_t j = first[static_cast<std::size_t>(column) - 1];
         j < first[static_cast<std::size_t>(column)]; ++j) {
      const double distance = std::fabs(p.fits[j].row - p.fits[i].row);
      if (distance > nearest) continue;
      nearest = distance;
      found = track[j];
    }
    return found;
  }

  /// Returns the change of depth of peak i of camera a per row, m/px.
  double row_step(std::size_t a, std::size_t i) const {
    const CameraPeaks& p = peaks_[a];
    const Eigen::Vector2d pixel(p.candidates[i].column, p.fits[i].row);
    return std::fabs(
        triangulation_jacobian(camera(p), geometry_.sheet, pixel, sheet_points_[a][i].point)(2, 1));
  }

  void decide(std::size_t a, std::size_t i, bool on_confirmed_track, const RayBins& rays) {
    const SheetPoint& s = sheet_points_[a][i];
    CameraAgreement& agreement = peaks_[a].agreement[i];
    if (s.bin < 0 || agreement == CameraAgreement::kConfirmed || s.refuted) return;
    // Peaks that continue a confirmed stripe have confirmed neighbours on the same surface.
    const double near = on_confirmed_track ? kNeighbours * row_step(a, i) : 0.0;
    if (rays.has_confirmed_elsewhere(s.bin, s.point.z(), near)) return;
    const unsigned others = rays.cameras(s.bin) & ~(1u << a);
    if (on_confirmed_track || others == 0) agreement = CameraAgreement::kUncontested;
  }

  std::vector<CameraPeaks>& peaks_;
  const SheetGeometry& geometry_;
  double tolerance_;
  std::vector<Rigid3> camera_from_sensor_;
  std::vector<std::vector<std::size_t>> starts_;
  std::vector<std::vector<SheetPoint>> sheet_points_;
};

}  // namespace

void compare_cameras(std::vector<CameraPeaks>& peaks, const SheetGeometry& geometry, double tolerance_px) {
  Comparison(peaks, geometry, tolerance_px).run();
}

}  // namespace sensor_rt
