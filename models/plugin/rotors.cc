#include "rotors.h"

#include <cmath>

#include "config.h"

namespace inclined_landing {
namespace {

constexpr char kName[] = "inclined_landing.rotors";
constexpr const char* kAttributes[] = {"lag_rate",     "state_gain",   "direct_gain", "drag",
                                       "pwm_to_force", "pwm_to_speed", "motors"};

// Total thrust [N] of one actuator from its activation and its command.
mjtNum Thrust(const RotorsConfig& config, const Hooks& hooks, mjtNum lag, mjtNum pwm) {
  return hooks.gain_scale * (config.state_gain * lag + config.direct_gain * pwm) + hooks.bias[0];
}

mjtNum ThrustOf(const mjModel* m, const mjData* d, const RotorsConfig& config, int actuator) {
  const mjtNum lag = d->act[m->actuator_actadr[actuator]];
  return Thrust(config, Hooks(m, actuator), lag, Command(m, d, actuator));
}

void ActDot(const mjModel* m, mjData* d, int instance) {
  const RotorsConfig* config = CachedConfig<RotorsConfig>(m, instance);
  if (!config) return;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    const int address = m->actuator_actadr[i];
    if (!ActuatorEnabled(m, i)) {
      d->act_dot[address] = 0;
      continue;
    }
    const Hooks hooks(m, i);
    mjtNum rate = (Command(m, d, i) - config->lag_rate * d->act[address]) / hooks.time_scale;
    if (m->opt.integrator != mjINT_RK4) {
      // The engine takes one Euler step: make it land on the zero-order-hold solution.
      const double decay = config->lag_rate / hooks.time_scale * m->opt.timestep;
      rate *= -std::expm1(-decay) / decay;
    }
    d->act_dot[address] = rate;
  }
}

void ComputeThrust(const mjModel* m, mjData* d, const RotorsConfig& config, int instance) {
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    d->actuator_force[m->actuator_outadr[i]] =
        ActuatorEnabled(m, i) ? ThrustOf(m, d, config, i) : 0;
  }
}

// Drag at the centre of mass. Runs before actuation: thrust is recomputed from the activation.
void ComputeDrag(const mjModel* m, mjData* d, const RotorsConfig& config, int instance) {
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance || !ActuatorEnabled(m, i)) continue;
    const mjtNum thrust = ThrustOf(m, d, config, i);
    const mjtNum relative = 1 + m->actuator_biasprm[i * mjNBIAS + 1];
    const mjtNum speed = config.SpeedSum(thrust) * relative;
    if (speed == 0) continue;
    const int body = m->site_bodyid[m->actuator_trnid[2 * i]];
    mjtNum velocity[6], air[3], local[3], force[3];
    mj_objectVelocity(m, d, mjOBJ_BODY, body, velocity, 0);
    mju_sub3(air, velocity + 3, m->opt.wind);
    mju_mulMatTVec3(local, d->xmat + 9 * body, air);
    for (int k = 0; k < 3; ++k) local[k] *= config.drag[k] * speed;
    mju_mulMatVec3(force, d->xmat + 9 * body, local);
    mj_applyFT(m, d, force, nullptr, d->xipos + 3 * body, body, d->qfrc_passive);
  }
}

int Init(const mjModel* m, mjData* d, int instance) {
  RotorsConfig config;
  std::string error;
  if (!config.Parse(m, instance, &error) || !CheckActuators(m, instance, kName, 1, &error)) {
    mju_warning("%s", error.c_str());
    return -1;
  }
  return 0;
}

}  // namespace

bool RotorsConfig::Parse(const mjModel* m, int instance, std::string* error) {
  const auto read = [&](const char* attribute, int count, double* values) {
    return ReadNumbers(m, instance, kName, attribute, count, values, error);
  };
  if (!read("lag_rate", 1, &lag_rate) || !read("state_gain", 1, &state_gain) ||
      !read("direct_gain", 1, &direct_gain) || !read("drag", 3, drag) ||
      !read("pwm_to_force", 3, pwm_to_force) || !read("pwm_to_speed", 2, pwm_to_speed) ||
      !read("motors", 1, &motors)) {
    return false;
  }
  const auto refuse = [&](const char* attribute, const char* rule) {
    *error = Refusal(kName, attribute, rule);
    return false;
  };
  if (lag_rate <= 0) return refuse("lag_rate", "greater than 0 (1/s)");
  if (state_gain < 0) return refuse("state_gain", "at least 0 (N/(PWM s))");
  if (direct_gain < 0) return refuse("direct_gain", "at least 0 (N/PWM)");
  if (drag[0] > 0 || drag[1] > 0 || drag[2] > 0) {
    return refuse("drag", "three numbers at most 0 (kg/rad): drag opposes the motion");
  }
  if (pwm_to_force[0] < 0 || pwm_to_force[1] <= 0 || pwm_to_force[2] < 0) {
    return refuse("pwm_to_force", "quadratic >= 0, linear > 0, constant >= 0 (N/PWM2, N/PWM, N)");
  }
  if (pwm_to_speed[0] < 0 || pwm_to_speed[1] < 0) {
    return refuse("pwm_to_speed", "two numbers at least 0 (rad/s/PWM, rad/s)");
  }
  if (motors < 1 || motors != std::floor(motors)) {
    return refuse("motors", "a whole number of at least 1");
  }
  return true;
}

double RotorsConfig::SpeedSum(double thrust) const {
  const double force = thrust / motors;
  const auto [a, b, c] = pwm_to_force;
  const auto [slope, idle] = pwm_to_speed;
  if (force <= 0) return 0;
  if (force < c) return motors * idle * force / c;
  // the positive root of a P^2 + b P + c = force, in the form that allows a = 0
  const double excess = force - c;
  const double pwm = 2 * excess / (b + std::sqrt(b * b + 4 * a * excess));
  return motors * (slope * pwm + idle);
}

void RegisterRotors() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = kName;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = &Init;
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.actuator_act_dot = &ActDot;
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability) {
    const RotorsConfig* config = CachedConfig<RotorsConfig>(m, instance);
    if (!config) return;
    if (capability == mjPLUGIN_ACTUATOR) ComputeThrust(m, d, *config, instance);
    if (capability == mjPLUGIN_PASSIVE) ComputeDrag(m, d, *config, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace inclined_landing
