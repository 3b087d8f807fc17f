// Selection among several peaks in a column. Internal to imaging.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// Agreement of a peak with the other cameras, best first.
enum class CameraAgreement : unsigned char {
  kConfirmed,    ///< another camera sees a peak at the same point
  kUncontested,  ///< no other camera sees this part of the sheet, or the rest of its stripe is confirmed
  kContradicted  ///< according to the other cameras the laser does not hit a surface there
};

/// All peaks of one camera in one exposure, sorted by column, then row.
struct CameraPeaks {
  int camera = 0;
  std::vector<Candidate> candidates;
  std::vector<StripeFit> fits;
  std::vector<CameraAgreement> agreement;  ///< empty unless the cameras were compared
};

/// Returns one candidate per column: the brightest, first or last.
std::vector<std::size_t> choose_by_rank(PeakChoice choice, const std::vector<Candidate>& candidates);

/// Removes the candidates that would not be chosen.
void keep_by_rank(PeakChoice choice, std::vector<Candidate>& candidates);

/// Returns one peak per column along the path over the columns that maximises brightness and minimises jumps
/// (dynamic programming): above half of `jump_px` rows per column the cost of a jump increases, up to the
/// score of 64 columns with the brightest peak. Where the cameras were compared, a better agreement outweighs
/// several jumps.
std::vector<std::size_t> choose_continuous(const CameraPeaks& peaks, double jump_px);

}  // namespace sensor_rt
