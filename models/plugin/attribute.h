// One attribute of a plugin: where its numbers or names go, and what they must be.
#pragma once

#include <string>
#include <vector>

namespace inclined_landing {

struct Attribute {
  const char* name;
  double* numbers;
  int count;
  bool (*good)(const double* numbers);  // null: any finite numbers
  const char* rule;                     // the same in words, after "must be"
  std::vector<std::string>* names;      // instead of numbers, or null
};

}  // namespace inclined_landing
