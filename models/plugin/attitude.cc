#include "attitude.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>

#include "attributes.h"
#include "config.h"

namespace inclined_landing {
namespace {

constexpr char kName[] = "inclined_landing.attitude";

// Below this cosine of roll (within 3 deg of 90 deg) the Euler rates are no longer resolved.
constexpr double kMinCosRoll = 0.05;

enum Axis { kRoll = 0, kPitch = 1, kYaw = 2 };

// Which axis an actuator drives: its gear is one rotational component and nothing else; else -1.
int AxisOf(const mjModel* m, int actuator) {
  const mjtNum* gear = m->actuator_gear + 6 * m->actuator_outadr[actuator];
  int axis = -1;
  for (int k = 0; k < 6; ++k) {
    if (gear[k] == 0) continue;
    if (k < 3 || axis >= 0) return -1;
    axis = k - 3;
  }
  return axis;
}

// What the loops hold: the estimate [rad] of roll or pitch, short of the tilt in the direction of flight.
double Held(const mjModel* m, const mjData* d, const AttitudeAttributes& config, int body, int axis) {
  const mjtNum* R = d->xmat + 9 * body;
  mjtNum velocity[6];
  mj_objectVelocity(m, d, mjOBJ_XBODY, body, velocity, 1);
  if (axis == kRoll) return std::asin(std::clamp(static_cast<double>(R[7]), -1.0, 1.0)) + config.lean * velocity[4];
  return std::atan2(-R[6], R[8]) - config.lean * velocity[3];
}

// Commanded less held angle [rad] of roll or pitch; without an actuator 0 is commanded.
double AngleError(const mjModel* m, const mjData* d, const AttitudeAttributes& config, int body, int axis,
                  int actuator) {
  const double held = Held(m, d, config, body, axis);
  if (actuator < 0) return -held;
  const Hooks hooks(m, actuator);
  return config.gain * hooks.gain_scale * (Command(m, d, actuator) + hooks.bias + config.trim[axis]) - held;
}

// Derivative [rad] of an actuator's integral of its angle error, which does not grow beyond the limit.
double IntegralRate(const mjModel* m, const mjData* d, const AttitudeAttributes& config, int actuator, double error) {
  const double integral = d->act[m->actuator_actadr[actuator]];
  return std::abs(integral) >= config.integral_limit && integral * error > 0 ? 0 : error;
}

bool Integrates(const AttitudeAttributes& config) { return config.integral != 0 || config.hold != 0; }

void ActDot(const mjModel* m, mjData* d, int instance) {
  const AttitudeAttributes* config = CachedConfig<AttitudeAttributes>(m, instance, kName);
  if (!config) return;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance || m->actuator_actnum[i] == 0) continue;
    const int address = m->actuator_actadr[i], body = m->site_bodyid[m->actuator_trnid[2 * i]];
    d->act_dot[address] = 0;
    if (!Integrates(*config) || !ActuatorEnabled(m, i)) continue;
    d->act_dot[address] = IntegralRate(m, d, *config, i, AngleError(m, d, *config, body, AxisOf(m, i), i));
  }
}

void Compute(const mjModel* m, mjData* d, int instance) {
  const AttitudeAttributes* config = CachedConfig<AttitudeAttributes>(m, instance, kName);
  if (!config) return;
  int actuators[3] = {-1, -1, -1};
  int any = -1;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    d->actuator_force[m->actuator_outadr[i]] = 0;
    if (!ActuatorEnabled(m, i)) continue;
    const int axis = AxisOf(m, i);
    if (axis < 0) continue;
    actuators[axis] = any = i;
  }
  if (any < 0) return;
  const int body = m->site_bodyid[m->actuator_trnid[2 * any]];

  // R = Rz(yaw) Rx(roll) Ry(pitch)
  const mjtNum* R = d->xmat + 9 * body;
  const double sin_roll = std::clamp(static_cast<double>(R[7]), -1.0, 1.0);
  const double cos_roll = std::sqrt(1 - sin_roll * sin_roll);
  const double guarded = std::max(cos_roll, kMinCosRoll);
  const double norm = std::hypot(R[6], R[8]);
  const double sin_pitch = norm > 0 ? -R[6] / norm : 0;
  const double cos_pitch = norm > 0 ? R[8] / norm : 1;

  mjtNum velocity[6];
  mj_objectVelocity(m, d, mjOBJ_XBODY, body, velocity, 1);
  const mjtNum* w = velocity;
  const double roll_rate = w[0] * cos_pitch + w[2] * sin_pitch;
  const double yaw_rate = (w[2] * cos_pitch - w[0] * sin_pitch) / guarded;
  const double pitch_rate = w[1] - yaw_rate * sin_roll;

  // Euler accelerations: the paper's loop, its wanted rate followed with bandwidth B
  const auto angle_acceleration = [&](Axis axis, double rate) {
    const int actuator = actuators[axis];
    const double tau = config->time_constant;
    double error = AngleError(m, d, *config, body, axis, actuator), integrated = 0;
    if (actuator >= 0 && m->actuator_actnum[actuator] > 0) {
      const double integral = config->integral + config->hold, held = config->hold * tau;
      integrated = integral * IntegralRate(m, d, *config, actuator, error) - held * rate;
      error += integral * d->act[m->actuator_actadr[actuator]] - held * Held(m, d, *config, body, axis);
    }
    const double wanted = error / tau;
    const double beyond = (config->damping - 1) * (config->bandwidth + 1 / tau);
    const double over = std::max(1.0, std::abs(wanted) * config->saturation);
    const double following = over > 1 ? 0 : (integrated - rate) / tau;
    return config->bandwidth * (wanted / over - rate) + following - beyond * rate;
  };
  double yaw_wanted = 0;
  if (actuators[kYaw] >= 0) {
    const Hooks hooks(m, actuators[kYaw]);
    const double gain = hooks.gain_scale * config->yaw_gain;
    yaw_wanted = gain * (Command(m, d, actuators[kYaw]) + hooks.bias) + config->yaw_drift;
  }
  const double roll_acc = angle_acceleration(kRoll, roll_rate);
  const double pitch_acc = angle_acceleration(kPitch, pitch_rate);
  const double yaw_acc = config->yaw_bandwidth * (yaw_wanted - yaw_rate);

  // time derivative of w = (roll' cp - yaw' cr sp, pitch' + yaw' sr, roll' sp + yaw' cr cp)
  const double horizontal = yaw_acc * cos_roll - yaw_rate * roll_rate * sin_roll;
  const double radial = pitch_rate * yaw_rate * cos_roll;
  const double cross = roll_rate * pitch_rate;
  const mjtNum acceleration[3] = {
      roll_acc * cos_pitch - cross * sin_pitch - horizontal * sin_pitch - radial * cos_pitch,
      pitch_acc + yaw_acc * sin_roll + yaw_rate * roll_rate * cos_roll,
      roll_acc * sin_pitch + cross * cos_pitch + horizontal * cos_pitch - radial * sin_pitch};

  // torque = J a + w x J w, in the principal axes and back
  const mjtNum* to_body = m->body_iquat + 4 * body;
  const mjtNum* inertia = m->body_inertia + 3 * body;
  mjtNum to_principal[4], rate[3], angular[3], momentum[3], gyroscopic[3], torque[3];
  mju_negQuat(to_principal, to_body);
  mju_rotVecQuat(rate, w, to_principal);
  mju_rotVecQuat(angular, acceleration, to_principal);
  for (int k = 0; k < 3; ++k) momentum[k] = inertia[k] * rate[k];
  mju_cross(gyroscopic, rate, momentum);
  for (int k = 0; k < 3; ++k) angular[k] = inertia[k] * angular[k] + gyroscopic[k];
  mju_rotVecQuat(torque, angular, to_body);

  for (int axis = kRoll; axis <= kYaw; ++axis) {
    const int actuator = actuators[axis];
    if (actuator < 0) continue;
    const int out = m->actuator_outadr[actuator];
    d->actuator_force[out] = torque[axis] / m->actuator_gear[6 * out + 3 + axis];
  }
}

// One vehicle body, each axis at most once, site axes equal to body axes.
// Integrals of roll and pitch where there are integral gains.
bool CheckAxes(const mjModel* m, const AttitudeAttributes& config, int instance, std::string* error) {
  bool taken[3] = {false, false, false};
  int body = -1;
  const std::string plugin = kName;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    const int site = m->actuator_trnid[2 * i];
    const mjtNum* quat = m->site_quat + 4 * site;
    const int axis = AxisOf(m, i);
    if (axis < 0) {
      *error = plugin + ": the gear of an actuator must be one rotational component, such as "
                        "\"0 0 0 1 0 0\" for roll";
    } else if (m->actuator_actnum[i] > (axis != kYaw) ||
               m->actuator_actnum[i] < (axis != kYaw && Integrates(config))) {
      *error = plugin + ": roll and pitch actuators must have actdim=\"1\" with the attribute 'integral' or 'hold', "
                        "and may have it without; a yaw actuator must have none";
    } else if (taken[axis]) {
      *error = plugin + ": two actuators of one instance must not drive the same axis";
    } else if (body >= 0 && body != m->site_bodyid[site]) {
      *error = plugin + ": the actuators of one instance must act on one body";
    } else if (std::abs(quat[0]) < 1 - 1e-12) {
      *error = plugin + ": the site of an actuator must have the axes of its body";
    } else {
      taken[axis] = true;
      body = m->site_bodyid[site];
      continue;
    }
    return false;
  }
  return true;
}

int Init(const mjModel* m, mjData* d, int instance) {
  AttitudeAttributes config;
  std::string error;
  if (!ReadAttributes(m, instance, kName, config.Table(), &error) ||
      !CheckNumbers(m, instance, kName, config.Table(), &error) || !CheckActuators(m, instance, kName, -1, &error) ||
      !CheckAxes(m, config, instance, &error)) {
    mju_warning("%s", error.c_str());
    return -1;
  }
  return 0;
}

}  // namespace

void RegisterAttitude() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = kName;
  plugin.nattribute = std::size(AttitudeAttributes::kNames);
  plugin.attributes = AttitudeAttributes::kNames;
  plugin.capabilityflags = mjPLUGIN_ACTUATOR;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = &Init;
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.actuator_act_dot = &ActDot;
  plugin.compute =
      +[](const mjModel* m, mjData* d, int instance, int) { Compute(m, d, instance); };
  mjp_registerPlugin(&plugin);
}

}  // namespace inclined_landing
