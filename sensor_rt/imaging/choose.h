// Which of several peaks in a column is the stripe. Internal to imaging.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// How a peak stands with the views of the other cameras, best first.
enum class Standing : unsigned char {
  kConfirmed,    ///< another camera sees a peak at the same point
  kUncontested,  ///< no other camera sees its part of the sheet, or its stripe is confirmed elsewhere
  kContradicted  ///< the other cameras show that the laser does not meet a surface there
};

/// All peaks of one camera in one exposure, sorted by column, then row.
struct CameraPeaks {
  int camera = 0;
  std::vector<Candidate> candidates;
  std::vector<StripeFit> fits;
  std::vector<Standing> standing;  ///< where the cameras were compared
};

/// One candidate per column: the brightest, first or last.
std::vector<std::size_t> choose_by_rank(PeakChoice choice, const std::vector<Candidate>& candidates);

/// Drops the candidates that would not be chosen.
void keep_by_rank(PeakChoice choice, std::vector<Candidate>& candidates);

/// One peak per column along the path over the columns that is bright and jumps little (dynamic programming):
/// from half of `jump_px` rows per column on a jump costs the more, up to what 64 columns of the brightest
/// peak can earn. Where the cameras were compared, a better standing is worth several jumps.
std::vector<std::size_t> choose_continuous(const CameraPeaks& peaks, double jump_px);

}  // namespace sensor_rt
