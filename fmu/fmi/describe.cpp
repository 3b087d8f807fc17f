// robotcell-describe: prints the model description of a cell ("-": read from standard input) for this build
// of the FMU.
#include <cstdio>
#include <exception>
#include <optional>
#include <string>

#include "fmu/fmi/model_description.h"

namespace {

using robotcell::fmi::DescriptionOptions;

/// Options after the file name; empty where they are invalid.
std::optional<DescriptionOptions> parse_options(int count, char** words) {
  DescriptionOptions options;
  for (int i = 0; i < count; ++i) {
    const std::string word = words[i];
    const std::string value = i + 1 < count ? words[i + 1] : "";
    if (word == "--clock") {
      options.clock = true;
    } else if (word == "--arrays") {
      options.arrays = true;
    } else if (word == "--ahead") {
      options.ahead = true;
    } else if (word == "--records") {
      options.records = true;
    } else if (word == "--integers") {
      options.integers = true;
    } else if (word == "--fmi" && (value == "2" || value == "3")) {
      options.version = words[++i][0] - '0';
    } else if (word == "--needs" && i + 1 < count) {
      options.needs = words[++i];
    } else {
      return {};
    }
  }
  return options;
}

}  // namespace

int main(int argc, char** argv) {
  const auto options = parse_options(argc - 2, argv + 2);
  if (argc < 2 || !options) {
    std::fprintf(stderr,
                 "usage: robotcell-describe CELL.json|- --fmi 2|3 [--clock] [--arrays] [--ahead] [--records] "
                 "[--integers] "
                 "[--needs TEXT]\n");
    return 2;
  }
  try {
    const auto cell = robotcell::parse_cell(robotcell::read_file_or_input(argv[1]));
    const std::string xml = robotcell::fmi::model_description(cell, *options);
    return std::fwrite(xml.data(), 1, xml.size(), stdout) == xml.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
    return 1;
  }
}
