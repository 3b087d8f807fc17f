// Must not compile: `forgotten` is not declared.
#include "fmu/model/fields.h"

struct WithConstructor {
  explicit WithConstructor(int n) : first(n) {}

  double first;
  bool second = false;
  bool forgotten = false;  // the size of the structure is the same without it
};

void check(WithConstructor& structure) { robotcell::require_members<2>(structure); }
