// What both plugins share: reading attributes, caching the result, reading commands.
#pragma once

#include <mujoco/mujoco.h>

#include <cstring>
#include <string>
#include <vector>

#include "attribute.h"

namespace inclined_landing {

// Reads and checks the attributes of a table; absent ones leave their values as they are.
// On failure returns false and puts a sentence into `error`.
bool ReadAttributes(const mjModel* m, int instance, const char* plugin,
                    const std::vector<Attribute>& table, std::string* error);

// Where the custom numeric with the instance's name begins, null without one: all numbers of the
// attributes in the order of their table, instead of those of the text. Unlike text it may differ between
// the simulations of a `mujoco.batch`.
inline const mjtNum* CustomNumbers(const mjModel* m, int instance, int* size) {
  const char* name = m->nnumeric ? mj_id2name(m, mjOBJ_PLUGIN, instance) : nullptr;
  const int numeric = name ? mj_name2id(m, mjOBJ_NUMERIC, name) : -1;
  if (numeric < 0) return nullptr;
  *size = m->numeric_size[numeric];
  return m->numeric_data + m->numeric_adr[numeric];
}

// Checks these numbers, if there are any, as those of attributes.
// On failure returns false and puts a sentence into `error`.
bool CheckNumbers(const mjModel* m, int instance, const char* plugin,
                  const std::vector<Attribute>& table, std::string* error);

// "<plugin>: attribute '<attribute>' must be <rule>".
std::string Refusal(const char* plugin, const char* attribute, const char* rule);

// The raw attribute text of an instance, a block of zero-terminated strings.
struct Text {
  const char* data;
  std::size_t size;
};

inline Text ConfigText(const mjModel* m, int instance) {
  const std::size_t begin = m->plugin_attradr[instance];
  const std::size_t end = instance + 1 < m->nplugin
                              ? static_cast<std::size_t>(m->plugin_attradr[instance + 1])
                              : static_cast<std::size_t>(m->npluginattr);
  return {m->plugin_attr + begin, end - begin};
}

// The parsed configuration of an instance, or null if the text is not valid. It holds until the thread's
// next call.
//
// `Config` needs a default constructor, `std::vector<Attribute> Table()`, `kNumbers` and `Take`.
// Each thread keeps its own few most recent texts. The key is the text itself, never a pointer, so
// a model that reuses another's memory, or two models in one batch, cannot read a stale value.
template <typename Config>
const Config* CachedConfig(const mjModel* m, int instance, const char* plugin) {
  struct Entry {
    std::vector<char> text;
    bool valid;
    Config config;
    Config own;  // with the custom numbers of whom it was last asked for
  };
  constexpr std::size_t kCapacity = 16;
  thread_local std::vector<Entry> entries;
  thread_local std::size_t next = 0;

  const auto read = [&](Entry& entry) -> const Config* {
    if (!entry.valid) return nullptr;
    int size = 0;
    const mjtNum* numbers = CustomNumbers(m, instance, &size);
    if (!numbers || size != Config::kNumbers) return &entry.config;
    entry.own.Take(numbers);
    return &entry.own;
  };
  const Text text = ConfigText(m, instance);
  for (Entry& entry : entries) {
    if (entry.text.size() == text.size &&
        std::memcmp(entry.text.data(), text.data, text.size) == 0) {
      return read(entry);
    }
  }
  Entry entry{{text.data, text.data + text.size}, false, Config{}, Config{}};
  std::string error;
  entry.valid = ReadAttributes(m, instance, plugin, entry.config.Table(), &error);
  entry.own = entry.config;
  if (entries.size() < kCapacity) {
    entries.reserve(kCapacity);
    entries.push_back(std::move(entry));
    next = entries.size() - 1;
  } else {
    next = (next + 1) % kCapacity;
    entries[next] = std::move(entry);
  }
  return read(entries[next]);
}

// Whether the engine lets this actuator act (actuation enabled, its group not disabled).
inline bool ActuatorEnabled(const mjModel* m, int actuator) {
  if (m->opt.disableflags & mjDSBL_ACTUATION) return false;
  const int group = m->actuator_group[actuator];
  return group < 0 || group > 30 || !(m->opt.disableactuator & (1 << group));
}

// The delayed command of an actuator whose history is held, not interpolated: its average over the
// time step. Every sample is taken as held for one step, so that the average is exact for delays that
// are no whole number of steps, and differentiable in the delay; all stages of RK4 get the same.
inline mjtNum HeldCommand(const mjModel* m, const mjData* d, int actuator) {
  const mjtNum* history = d->history + m->actuator_historyadr[actuator];  // user, newest, times, values
  const int count = m->actuator_history[2 * actuator], newest = static_cast<int>(history[1]);
  const auto sample = [&](int steps_ago) {
    if (steps_ago == 0) return d->ctrl[m->actuator_ctrladr[actuator]];
    const int back = steps_ago > count ? count - 1 : steps_ago - 1;
    return history[2 + count + (newest - back + count) % count];
  };
  const mjtNum steps = m->actuator_delay[actuator] / m->opt.timestep;
  const int whole = static_cast<int>(mju_min(steps, count));
  const mjtNum part = mju_min(steps, count) - whole;
  const mjtNum later = sample(whole);
  return part > 0 ? (1 - part) * later + part * sample(whole + 1) : later;
}

// The command an actuator gets: delayed, clamped to ctrlrange, 0 if it is not a number.
inline mjtNum Command(const mjModel* m, const mjData* d, int actuator) {
  const int address = m->actuator_ctrladr[actuator];
  mjtNum command = d->ctrl[address];
  if (m->actuator_delay[actuator] > 0 && m->actuator_history[2 * actuator + 1] == 0) {
    command = HeldCommand(m, d, actuator);
  } else if (m->actuator_delay[actuator] > 0) {
    mjtNum interpolated = 0;
    const mjtNum* sample = mj_readCtrl(m, d, actuator, d->time, &interpolated,
                                       m->actuator_history[2 * actuator + 1]);
    command = sample ? *sample : interpolated;
  }
  if (mju_isBad(command)) return 0;
  if (m->actuator_ctrllimited[address] && !(m->opt.disableflags & mjDSBL_CLAMPCTRL)) {
    const mjtNum* range = m->actuator_ctrlrange + 2 * address;
    command = mju_clip(command, range[0], range[1]);
  }
  return command;
}

// The hooks: model fields that scale an actuator, neutral at MuJoCo's defaults (1, 0).
struct Hooks {
  mjtNum gain_scale;
  mjtNum bias;

  Hooks(const mjModel* m, int actuator)
      : gain_scale(m->actuator_gainprm[actuator * mjNGAIN]),
        bias(m->actuator_biasprm[actuator * mjNBIAS]) {}
};

// Checks what both plugins need of the actuators of an instance: at least one, each on a site,
// with `actdim` activations, or any number where it is negative. On failure returns false and puts a sentence into `error`.
bool CheckActuators(const mjModel* m, int instance, const char* plugin, int actdim,
                    std::string* error);

}  // namespace inclined_landing
