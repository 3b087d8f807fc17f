// An instance of the robot cell.
#pragma once

#include <memory>
#include <string>

#include "fmu/fmi/instance.h"
#include "fmu/fmi/snapshot.h"
#include "fmu/model/cell.h"

namespace robotcell::fmi {

/// A cell description loaded from a file.
struct LoadedCell {
  std::string path;
  std::uint64_t hash = 0;       // of the file content
  CellDescription description;  // without the meshes of the bodies
  proximity::BodySet bodies;
};

/// Loads a description. `known` is reused where the file is the same, else its bounding volumes of equal
/// meshes. Throws DescriptionError that names the file.
std::shared_ptr<const LoadedCell> load_cell(const std::string& path,
                                            const std::shared_ptr<const LoadedCell>& known = nullptr);

class CellInstance : public Instance {
 public:
  /// Loads the cell in the FMU's resources, whose layout determines the variables.
  CellInstance(const std::string& name, std::string resource_location, const Log& log,
               const StepOptions& options);

  bool use_variant(const std::string& token, int version) override;
  StepResult do_step(double current, double step) override;
  std::unique_ptr<SavedState> snapshot() const override;
  void restore(const SavedState& state) override;
  std::vector<std::uint8_t> serialize(const SavedState& state) const override;
  std::unique_ptr<SavedState> deserialize(const std::uint8_t* bytes, std::size_t size) const override;

 private:
  void start() override { cell(); }
  void clear() override;
  void before_get(const Variable& variable) override;
  void after_set(const Variable& variable) override;
  bool is_path_ahead(const Variable& variable) const;
  void refresh_outputs();
  void refresh_path_ahead();
  void refresh_records();
  Cell& cell();
  void start_unset_inputs(const CellDescription& cell);
  std::string description_path(const std::string& file) const;
  void log_refusal();
  void log_step(Events happened, bool early);

  std::string resource_location_;
  std::shared_ptr<const LoadedCell> default_cell_;  // the description in the FMU's resources
  std::shared_ptr<const LoadedCell> loaded_;        // the description loaded last
  CellLayout layout_;
  Values values_;
  HomeInputFlags home_inputs_set_{};  // set by the importer; other home inputs follow the loaded cell
  bool outputs_fresh_ = false;
  bool ahead_fresh_ = false;  // the path ahead is evaluated only where it is read
  std::int32_t logged_limit_ = 0;
  std::string logged_refusal_;
  std::unique_ptr<Cell> cell_;  // created from loaded_
};

}  // namespace robotcell::fmi
