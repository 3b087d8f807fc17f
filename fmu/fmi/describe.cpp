// robotcell-describe: prints the model description that belongs to a cell ("-": on standard input) and to
// this build of the FMU.
#include <cstdio>
#include <cstring>
#include <exception>

#include "fmu/fmi/model_description.h"

int main(int argc, char** argv) {
  const bool clock = argc == 5 && std::strcmp(argv[4], "--clock") == 0;
  if ((argc != 4 && !clock) || std::strcmp(argv[2], "--fmi") != 0 ||
      (std::strcmp(argv[3], "2") != 0 && std::strcmp(argv[3], "3") != 0)) {
    std::fprintf(stderr, "usage: robotcell-describe CELL.json|- --fmi 2|3 [--clock]\n");
    return 2;
  }
  try {
    const auto cell = robotcell::parse_cell(robotcell::read_text_file(argv[1]));
    const std::string xml = robotcell::fmi::model_description(cell, argv[3][0] - '0', clock);
    return std::fwrite(xml.data(), 1, xml.size(), stdout) == xml.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
    return 1;
  }
}
