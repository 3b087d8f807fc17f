// Instances whose state is the values of their variables, and a few numbers that are none.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "fmu/fmi/instance.h"

namespace robotcell::fmi {

class TableInstance : public Instance {
 public:
  std::unique_ptr<SavedState> snapshot() const override;
  void restore(const SavedState& state) override;
  std::vector<std::uint8_t> serialize(const SavedState& state) const override;
  std::unique_ptr<SavedState> deserialize(const std::uint8_t* bytes, std::size_t size) const override;

 protected:
  using Instance::Instance;

  /// Called for restored values, which are within their bounds; throws std::exception where they contradict
  /// each other.
  virtual void check_restored() const {}

  double memory_ = 0;  // part of the state that is no variable

 private:
  struct State;
};

}  // namespace robotcell::fmi
