// Location of the FMU's resources as given by the importer.
#pragma once

#include <string>

namespace robotcell::fmi {

/// Folder without a trailing separator, from a file URI (one to four slashes, with or without localhost,
/// percent-encoded) or a plain path. Throws std::invalid_argument.
std::string resource_folder(const std::string& location);

}  // namespace robotcell::fmi
