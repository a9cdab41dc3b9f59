#include "config.h"

#include <cmath>
#include <locale>
#include <sstream>

namespace inclined_landing {

bool ReadNumbers(const mjModel* m, int instance, const char* plugin, const char* attribute,
                 int count, double* values, std::string* error) {
  const char* text = mj_getPluginConfig(m, instance, attribute);
  if (text == nullptr || text[0] == '\0') return true;
  std::istringstream stream(text);
  stream.imbue(std::locale::classic());
  std::vector<double> numbers;
  double number;
  while (stream >> number) numbers.push_back(number);
  bool good = stream.eof() && static_cast<int>(numbers.size()) == count;
  for (double value : numbers) good = good && std::isfinite(value);
  if (!good) {
    std::ostringstream rule;
    rule << count << (count == 1 ? " finite number" : " finite numbers") << ", it is '" << text
         << "'";
    *error = Refusal(plugin, attribute, rule.str().c_str());
    return false;
  }
  for (int i = 0; i < count; ++i) values[i] = numbers[i];
  return true;
}

std::string Refusal(const char* plugin, const char* attribute, const char* rule) {
  return std::string(plugin) + ": attribute '" + attribute + "' must be " + rule;
}

bool CheckActuators(const mjModel* m, int instance, const char* plugin, int actdim,
                    std::string* error) {
  bool found = false;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    found = true;
    const char* given = mj_id2name(m, mjOBJ_ACTUATOR, i);
    const std::string name = given ? given : "#" + std::to_string(i);
    if (m->actuator_trntype[i] != mjTRN_SITE) {
      *error = std::string(plugin) + ": actuator '" + name + "' must act on a site of the vehicle";
      return false;
    }
    if (m->actuator_actnum[i] != actdim) {
      *error = std::string(plugin) + ": actuator '" + name + "' must have actdim=\"" +
               std::to_string(actdim) + "\", it has " + std::to_string(m->actuator_actnum[i]);
      return false;
    }
  }
  if (!found) *error = std::string(plugin) + ": the instance must drive at least one actuator";
  return found;
}

}  // namespace inclined_landing
