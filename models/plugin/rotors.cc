#include "rotors.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>
#include <vector>

#include "config.h"

namespace inclined_landing {
namespace {

constexpr char kName[] = "inclined_landing.rotors";

// Thrust [N] of one actuator from its activation and its command: what sets the rotors' speed.
mjtNum ThrustOf(const mjModel* m, const mjData* d, const RotorsConfig& config, int actuator) {
  const Hooks hooks(m, actuator);
  const mjtNum lag = d->act[m->actuator_actadr[actuator]], pwm = Command(m, d, actuator);
  const mjtNum thrust =
      hooks.gain_scale * (config.state_gain * lag + config.direct_gain * pwm) + hooks.bias;
  const mjtNum load = config.lag_rate * lag;
  const mjtNum voltage =
      config.voltage_open - config.voltage_drop * load - config.voltage_discharge * d->time;
  return (thrust + config.bias) * (1 - config.fade * d->time) *
         (1 - config.sag * (load / config.sag_reference - 1)) *
         (1 + config.voltage_sensitivity * (voltage - config.voltage_reference));
}

int BodyOf(const mjModel* m, int actuator) {
  return m->site_bodyid[m->actuator_trnid[2 * actuator]];
}

// Velocity of the centre of mass relative to the air, in the body's axes.
void AirVelocity(const mjModel* m, const mjData* d, int body, mjtNum air[3]) {
  mjtNum velocity[6], relative[3];
  mj_objectVelocity(m, d, mjOBJ_BODY, body, velocity, 0);
  mju_sub3(relative, velocity + 3, m->opt.wind);
  mju_mulMatTVec3(air, d->xmat + 9 * body, relative);
}

// Share of the thrust that the rotors have not lost.
mjtNum Intact(const RotorsConfig& config) {
  const auto [one, two, three, four] = config.rotor_loss;
  return 1 - 0.25 * (one + two + three + four);
}

// Where the thrust of all rotors acts, x forward and y left of their middle [m].
void ThrustCentre(const RotorsConfig& config, mjtNum centre[2]) {
  const auto [one, two, three, four] = config.rotor_loss;
  const mjtNum arm = config.arm / (4 * Intact(config));
  centre[0] = arm * (two + three - one - four);
  centre[1] = arm * (one + two - three - four);
}

// Thrust times this, by the air that the rotors meet.
mjtNum Inflow(const RotorsConfig& config, const mjtNum air[3]) {
  return (1 + config.translational_lift * (air[0] * air[0] + air[1] * air[1])) *
         mju_max(0, 1 - config.axial_inflow * air[2]);
}

// Share of a disc on the inner side of a straight edge, its centre `distance` within.
mjtNum DiscInside(mjtNum distance, mjtNum radius) {
  const mjtNum d = mju_clip(distance / radius, -1, 1);
  return 0.5 + (d * std::sqrt(1 - d * d) + std::asin(d)) / mjPI;
}

// Share of thrust that a rotor gains all over a surface, its disc's centre `height` [m] from it.
mjtNum GroundGain(const RotorsConfig& config, mjtNum height) {
  const mjtNum ratio = height > 0.5 * config.disc_radius ? config.disc_radius / (4 * height) : 0.5;
  const mjtNum fading = std::exp((4 * config.disc_radius - height) * config.ground_fading);
  return mju_min(1, config.ground_effect * ratio * ratio * fading);
}

// What a rotor at `point` gains from the upper faces of the planes and boxes named as surfaces, along its
// axis: each with the share of the disc that is over it and that nearer ones leave.
mjtNum Gain(const mjModel* m, const mjData* d, const RotorsConfig& config, const mjtNum point[3],
            const mjtNum axis[3]) {
  struct Face {
    mjtNum distance, share, gain;
  };
  thread_local std::vector<Face> faces;
  faces.clear();
  for (const std::string& name : config.surfaces) {
    const int geom = mj_name2id(m, mjOBJ_GEOM, name.c_str());
    if (geom < 0) continue;
    const mjtNum *frame = d->geom_xmat + 9 * geom, *size = m->geom_size + 3 * geom;
    mjtNum offset[3], at[3], up[3];
    mju_sub3(offset, point, d->geom_xpos + 3 * geom);
    mju_mulMatTVec3(at, frame, offset);
    mju_mulMatTVec3(up, frame, axis);
    const bool plane = m->geom_type[geom] == mjGEOM_PLANE;
    const mjtNum height = at[2] - (plane ? 0 : size[2]);
    if (height <= 0 || up[2] <= 0) continue;
    const mjtNum distance = height / up[2];
    mjtNum share = 1;
    for (int k = 0; k < 2; ++k) {
      if (plane && size[k] == 0) continue;  // without end
      share *= DiscInside(size[k] - std::abs(at[k] - distance * up[k]), config.disc_radius);
    }
    if (share > 0) faces.push_back({distance, share, GroundGain(config, height)});
  }
  std::sort(faces.begin(), faces.end(), [](const Face& a, const Face& b) { return a.distance < b.distance; });
  mjtNum gain = 0, left = 1;
  for (const Face& face : faces) {
    gain += left * face.share * face.gain;
    left *= 1 - face.share;
  }
  return gain;
}

// Extra thrust [N] and torque about body x and y [N m] of the rotors near a surface.
mjtNum GroundEffect(const mjModel* m, const mjData* d, const RotorsConfig& config, int body,
                    mjtNum thrust, mjtNum torque[2]) {
  const mjtNum* frame = d->xmat + 9 * body;
  const mjtNum axis[3] = {frame[2], frame[5], frame[8]};
  torque[0] = torque[1] = 0;
  mjtNum extra = 0;
  if (config.ground_effect == 0 || axis[2] <= 0) return 0;
  for (int side = 0; side < 4; ++side) {
    const mjtNum arm[3] = {side < 2 ? config.arm : -config.arm,
                           side % 2 == 0 ? config.arm : -config.arm, config.disc_height};
    mjtNum point[3];
    mju_mulMatVec3(point, frame, arm);
    mju_addTo3(point, d->xpos + 3 * body);
    const mjtNum force = 0.25 * thrust * Gain(m, d, config, point, axis);
    extra += force;
    torque[0] += arm[1] * force;
    torque[1] -= arm[0] * force;
  }
  return extra;
}

void ActDot(const mjModel* m, mjData* d, int instance) {
  const RotorsConfig* config = CachedConfig<RotorsConfig>(m, instance, kName);
  if (!config) return;
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    const int address = m->actuator_actadr[i];
    if (!ActuatorEnabled(m, i)) {
      d->act_dot[address] = 0;
      continue;
    }
    mjtNum rate = Command(m, d, i) - config->lag_rate * d->act[address];
    const mjtNum slower = rate < 0 ? 1 + config->spin_down : 1;
    rate /= slower;
    if (m->opt.integrator != mjINT_RK4) {
      // The engine takes one Euler step: make it land on the zero-order-hold solution.
      const double decay = config->lag_rate / slower * m->opt.timestep;
      rate *= -std::expm1(-decay) / decay;
    }
    d->act_dot[address] = rate;
  }
}

void ComputeThrust(const mjModel* m, mjData* d, const RotorsConfig& config, int instance) {
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance) continue;
    mjtNum* force = d->actuator_force + m->actuator_outadr[i];
    *force = 0;
    if (!ActuatorEnabled(m, i)) continue;
    mjtNum air[3], torque[2];
    AirVelocity(m, d, BodyOf(m, i), air);
    *force = ThrustOf(m, d, config, i) * Intact(config) * Inflow(config, air);
    *force += GroundEffect(m, d, config, BodyOf(m, i), *force, torque);
  }
}

// Drag at the centre of mass and the moment of ground effect. Runs before actuation: thrust is
// recomputed from the activation.
void ComputePassive(const mjModel* m, mjData* d, const RotorsConfig& config, int instance) {
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] != instance || !ActuatorEnabled(m, i)) continue;
    const mjtNum thrust = ThrustOf(m, d, config, i);
    const mjtNum speed = config.SpeedSum(thrust);
    const int body = BodyOf(m, i);
    mjtNum air[3], local[3], force[3], moment[3] = {0, 0, 0}, torque[3], centre[2];
    AirVelocity(m, d, body, air);
    const mjtNum body_drag = config.body_drag * mju_norm3(air);
    for (int k = 0; k < 3; ++k) local[k] = air[k] * (config.drag[k] * speed) - air[k] * body_drag;
    mju_mulMatVec3(force, d->xmat + 9 * body, local);
    mjtNum lift = thrust * Intact(config) * Inflow(config, air);
    lift += GroundEffect(m, d, config, body, lift, moment);
    ThrustCentre(config, centre);
    moment[0] += centre[1] * lift;
    moment[1] -= centre[0] * lift;
    mju_mulMatVec3(torque, d->xmat + 9 * body, moment);
    mj_applyFT(m, d, force, torque, d->xipos + 3 * body, body, d->qfrc_passive);
  }
}

// The surfaces that ground effect needs are there, and have an upper face.
bool CheckSurfaces(const mjModel* m, const RotorsConfig& config, std::string* error) {
  if (config.ground_effect == 0) return true;
  for (const std::string& name : config.surfaces) {
    const int geom = mj_name2id(m, mjOBJ_GEOM, name.c_str());
    if (geom >= 0 && (m->geom_type[geom] == mjGEOM_PLANE || m->geom_type[geom] == mjGEOM_BOX)) continue;
    *error = Refusal(kName, "surfaces", "names of planes and boxes") + ", there is none named '" + name +
             "'";
    return false;
  }
  return true;
}

int Init(const mjModel* m, mjData* d, int instance) {
  RotorsConfig config;
  std::string error;
  if (!ReadAttributes(m, instance, kName, config.Table(), &error) ||
      !CheckNumbers(m, instance, kName, config.Table(), &error) || !CheckActuators(m, instance, kName, 1, &error) ||
      !CheckSurfaces(m, config, &error)) {
    mju_warning("%s", error.c_str());
    return -1;
  }
  return 0;
}

}  // namespace

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
  plugin.nattribute = std::size(RotorsConfig::kNames);
  plugin.attributes = RotorsConfig::kNames;
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = &Init;
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.actuator_act_dot = &ActDot;
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability) {
    const RotorsConfig* config = CachedConfig<RotorsConfig>(m, instance, kName);
    if (!config) return;
    if (capability == mjPLUGIN_ACTUATOR) ComputeThrust(m, d, *config, instance);
    if (capability == mjPLUGIN_PASSIVE) ComputePassive(m, d, *config, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace inclined_landing
