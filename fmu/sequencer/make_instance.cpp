// The instances of the FMU of the sequencer.
#include "fmu/fmi/resource_location.h"
#include "fmu/sequencer/sequencer.h"

namespace robotcell::fmi {

std::unique_ptr<Instance> make_instance(const std::string& name, const std::string& resource_location,
                                        const Log& log, const StepOptions& options) {
  const std::string folder = resource_folder(resource_location);
  return std::make_unique<sequencer::Sequencer>(parse_cell(read_text_file(folder + "/cell.json")), name, log,
                                                options);
}

}  // namespace robotcell::fmi
