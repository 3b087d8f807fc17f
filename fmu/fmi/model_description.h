// modelDescription.xml of either FMI version, made from the variable table.
#pragma once

#include <string>

#include "fmu/model/cell_description.h"

namespace robotcell::fmi {

/// `version` is 2 or 3. The cell gives name and step size; everything else comes from the variable table.
std::string model_description(const CellDescription& cell, int version);

}  // namespace robotcell::fmi
