// sequencer-describe: prints the model description of a sequencer for a cell ("-": read from standard input).
// Modes, states and errors are integers, which all importers know.
#include <cstdio>
#include <exception>
#include <string>

#include "fmu/control/time_units.h"
#include "fmu/fmi/model_description.h"
#include "fmu/sequencer/sequencer.h"

int main(int argc, char** argv) {
  const std::string version = argc == 4 && std::string(argv[2]) == "--fmi" ? argv[3] : "";
  if (version != "2" && version != "3") {
    std::fprintf(stderr, "usage: sequencer-describe CELL.json|- --fmi 2|3\n");
    return 2;
  }
  try {
    const robotcell::CellDescription cell = robotcell::parse_cell(robotcell::read_file_or_input(argv[1]));
    const robotcell::sequencer::Sequencer sequencer(cell);
    robotcell::fmi::DescriptionOptions options;
    options.version = version[0] - '0';
    options.integers = true;
    const double cycle = static_cast<double>(cell.controller_cycle_us) / robotcell::kMicrosecondsPerSecond;
    const std::string xml = robotcell::fmi::model_description(
        {"CellSequencer", "Commands a robot cell step by step: " + cell.name, cycle, 0, false},
        sequencer.table(), options);
    return std::fwrite(xml.data(), 1, xml.size(), stdout) == xml.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
    return 1;
  }
}
