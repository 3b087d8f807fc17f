// modelDescription.xml of either FMI version, made from the variable table.
#pragma once

#include <string>

#include "fmu/model/cell_description.h"

namespace robotcell::fmi {

struct DescriptionOptions {
  int version = 3;  // 2 or 3
  /// Describes the clock of the trigger records as well (FMI 3): importers that know no clocks crash on it,
  /// and event mode works without.
  bool clock = false;
  /// Merges indexed scalars into arrays (FMI 3): few importers read arrays, some read zeros instead.
  bool arrays = false;
  /// What the binaries need from the machine, for the description; may be empty.
  std::string needs;
};

/// The cell gives name and step size; everything else comes from the variable table.
std::string model_description(const CellDescription& cell, const DescriptionOptions& options);

}  // namespace robotcell::fmi
