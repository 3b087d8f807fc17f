// modelDescription.xml of either FMI version, made from the variable table.
#pragma once

#include <string>

#include "fmu/model/cell_description.h"

namespace robotcell::fmi {

/// `version` is 2 or 3. The cell gives name and step size; everything else comes from the variable table.
/// `clock` describes the clock of the trigger records as well (FMI 3): importers that know no clocks crash on
/// it, and event mode works without.
std::string model_description(const CellDescription& cell, int version, bool clock);

}  // namespace robotcell::fmi
