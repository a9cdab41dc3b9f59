#include "config.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <locale>
#include <sstream>

namespace inclined_landing {

namespace {

// Reads finite numbers; false and a sentence in `error` if they are anything else.
bool ReadNumbers(const char* text, const char* plugin, const Attribute& attribute, std::string* error) {
  std::istringstream stream(text);
  stream.imbue(std::locale::classic());
  std::vector<double> numbers;
  double number;
  while (stream >> number) numbers.push_back(number);
  bool good = stream.eof() && static_cast<int>(numbers.size()) == attribute.count;
  for (double value : numbers) good = good && std::isfinite(value);
  if (!good) {
    std::ostringstream rule;
    rule << attribute.count << (attribute.count == 1 ? " finite number" : " finite numbers")
         << ", it is '" << text << "'";
    *error = Refusal(plugin, attribute.name, rule.str().c_str());
    return false;
  }
  std::copy(numbers.begin(), numbers.end(), attribute.numbers);
  if (attribute.good && !attribute.good(attribute.numbers)) {
    *error = Refusal(plugin, attribute.name, attribute.rule);
    return false;
  }
  return true;
}

}  // namespace

bool ReadAttributes(const mjModel* m, int instance, const char* plugin,
                    const std::vector<Attribute>& table, std::string* error) {
  for (const Attribute& attribute : table) {
    const char* text = mj_getPluginConfig(m, instance, attribute.name);
    if (text == nullptr || text[0] == '\0') continue;
    if (attribute.names) {
      std::istringstream stream(text);
      attribute.names->assign(std::istream_iterator<std::string>(stream), {});
    } else if (!ReadNumbers(text, plugin, attribute, error)) {
      return false;
    }
  }
  return true;
}

bool CheckNumbers(const mjModel* m, int instance, const char* plugin,
                  const std::vector<Attribute>& table, std::string* error) {
  int size = 0, count = 0;
  const mjtNum* numbers = CustomNumbers(m, instance, &size);
  if (!numbers) return true;
  for (const Attribute& attribute : table) count += attribute.count;
  if (size != count) {
    *error = std::string(plugin) + ": the custom numeric '" + mj_id2name(m, mjOBJ_PLUGIN, instance) +
             "' must hold the " + std::to_string(count) + " numbers of the attributes, it holds " +
             std::to_string(size);
    return false;
  }
  for (const Attribute& attribute : table) {
    bool good = true;
    for (int k = 0; k < attribute.count; ++k) good = good && std::isfinite(numbers[k]);
    if (!good || (attribute.good && !attribute.good(numbers))) {
      *error = Refusal(plugin, attribute.name, good ? attribute.rule : "finite");
      return false;
    }
    numbers += attribute.count;
  }
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
    if (actdim >= 0 && m->actuator_actnum[i] != actdim) {
      *error = std::string(plugin) + ": actuator '" + name + "' must have actdim=\"" +
               std::to_string(actdim) + "\", it has " + std::to_string(m->actuator_actnum[i]);
      return false;
    }
  }
  if (!found) *error = std::string(plugin) + ": the instance must drive at least one actuator";
  return found;
}

}  // namespace inclined_landing
