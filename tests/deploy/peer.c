/* The other end of the wire, on the CycloneDDS of robots: usage: peer DOMAIN robot|client, until SIGTERM

   A robot publishes states at 500 Hz and reads commands; a client does the reverse. Both fill every byte of their
   messages with a pattern, check the sums of what they read over their own memory layout, and say how it went. */
#include "dds/dds.h"
#include "unitree.h"
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef unitree_go_msg_dds__LowCmd_ command_t;
typedef unitree_go_msg_dds__LowState_ state_t;

static volatile sig_atomic_t stopped = 0;

static void stop (int number)
{
  (void) number;
  stopped = 1;
}

static uint32_t checksum (const void *message, size_t size)
{
  const uint8_t *octets = message;
  uint32_t sum = 0xffffffffu;
  for (size_t word = 0; word + 8 <= size; word += 4)
    for (int k = 3; k >= 0; k--)
      for (int bit = 7; bit >= 0; bit--)
        sum = (sum << 1) ^ ((sum >> 31 ^ (octets[word + (size_t) k] >> bit & 1u)) ? 0x04c11db7u : 0u);
  return sum;
}

static void fill_state (state_t *s, uint32_t tick)
{
  memset (s, 0, sizeof *s);
  s->head[0] = 0xfe; s->head[1] = 0xef; s->level_flag = 0xff; s->frame_reserve = 3;
  s->sn[0] = 4; s->sn[1] = 5; s->version[0] = 6; s->version[1] = 7; s->bandwidth = 8;
  s->imu_state.quaternion[0] = 1.0f;
  for (int k = 0; k < 3; k++) {
    s->imu_state.gyroscope[k] = 0.1f * (float) (k + 1);
    s->imu_state.accelerometer[k] = (float) (k + 7);
    s->imu_state.rpy[k] = 0.01f * (float) k;
  }
  s->imu_state.temperature = 61;
  for (int j = 0; j < 20; j++) {
    float q[3] = { 0.05f, 0.9f, -1.8f };
    s->motor_state[j].mode = 1; s->motor_state[j].q = q[j % 3];
    s->motor_state[j].dq = 0.25f * (float) j; s->motor_state[j].ddq = 9.0f; s->motor_state[j].tau_est = 0.5f * (float) j;
    s->motor_state[j].q_raw = 1.0f; s->motor_state[j].dq_raw = 2.0f; s->motor_state[j].ddq_raw = 3.0f;
    s->motor_state[j].temperature = (uint8_t) (30 + j); s->motor_state[j].lost = 17;
    s->motor_state[j].reserve[0] = 18; s->motor_state[j].reserve[1] = 19;
  }
  s->bms_state.version_high = 1; s->bms_state.version_low = 2; s->bms_state.status = 3; s->bms_state.soc = 88;
  s->bms_state.current = -1234; s->bms_state.cycle = 77;
  for (int k = 0; k < 2; k++) s->bms_state.bq_ntc[k] = s->bms_state.mcu_ntc[k] = (uint8_t) (33 + k);
  for (int k = 0; k < 15; k++) s->bms_state.cell_vol[k] = (uint16_t) (3800 + k);
  for (int k = 0; k < 4; k++) { s->foot_force[k] = (int16_t) (-5 + 20 * k); s->foot_force_est[k] = (int16_t) k; }
  s->tick = tick;
  for (int k = 0; k < 40; k++) s->wireless_remote[k] = (uint8_t) k;
  s->bit_flag = 9; s->adc_reel = 1.5f; s->temperature_ntc1 = 41; s->temperature_ntc2 = 42;
  s->power_v = 31.0f; s->power_a = 2.0f;
  for (int k = 0; k < 4; k++) s->fan_frequency[k] = (uint16_t) (100 + k);
  s->reserve = 10;
  s->crc = checksum (s, sizeof *s);
}

static void fill_command (command_t *c, uint32_t number)
{
  memset (c, 0, sizeof *c);
  c->head[0] = 0xfe; c->head[1] = 0xef; c->level_flag = 0xff; c->frame_reserve = 1;
  c->sn[0] = 2; c->sn[1] = 3; c->version[0] = 4; c->version[1] = 5; c->bandwidth = 6;
  for (int j = 0; j < 20; j++) {
    c->motor_cmd[j].mode = 1; c->motor_cmd[j].q = 0.1f * (float) j; c->motor_cmd[j].dq = 0.2f * (float) j;
    c->motor_cmd[j].tau = 0.3f * (float) j; c->motor_cmd[j].kp = 1.0f + (float) j; c->motor_cmd[j].kd = 2.0f + (float) j;
    for (int k = 0; k < 3; k++) c->motor_cmd[j].reserve[k] = (uint32_t) (70 + k);
  }
  c->bms_cmd.off = 0; c->bms_cmd.reserve[1] = 8;
  for (int k = 0; k < 40; k++) c->wireless_remote[k] = (uint8_t) (40 - k);
  for (int k = 0; k < 12; k++) c->led[k] = (uint8_t) (k + 1);
  c->fan[0] = 11; c->fan[1] = 12; c->gpio = 13;
  c->reserve = number;
  c->crc = checksum (c, sizeof *c);
}

int main (int argc, char **argv)
{
  if (argc != 3) return 2;
  const int robot = strcmp (argv[2], "robot") == 0;
  signal (SIGTERM, stop);
  dds_entity_t participant = dds_create_participant ((dds_domainid_t) atoi (argv[1]), NULL, NULL);
  if (participant < 0) { fprintf (stderr, "%s\n", dds_strretcode (participant)); return 1; }
  dds_entity_t commands = dds_create_topic (participant, &unitree_go_msg_dds__LowCmd__desc, "rt/lowcmd", NULL, NULL);
  dds_entity_t states = dds_create_topic (participant, &unitree_go_msg_dds__LowState__desc, "rt/lowstate", NULL, NULL);
  dds_qos_t *deep = dds_create_qos ();
  dds_qset_history (deep, DDS_HISTORY_KEEP_LAST, 256);
  dds_entity_t reader = dds_create_reader (participant, robot ? commands : states, deep, NULL);
  dds_entity_t writer = dds_create_writer (participant, robot ? states : commands, NULL, NULL);
  long sent = 0, received = 0, wrong = 0, gaps = 0, last = -1, odd_offsets = 0;
  for (dds_time_t due = dds_time (); !stopped; due += 2000000) {
    void *samples[256] = { NULL };
    dds_sample_info_t infos[256];
    int taken = dds_take (reader, samples, infos, 256, 256);
    for (int i = 0; i < taken; i++) {
      if (!infos[i].valid_data) continue;
      received++;
      const size_t size = robot ? sizeof (command_t) : sizeof (state_t);
      uint32_t crc;
      memcpy (&crc, (const char *) samples[i] + size - 4, 4);
      if (crc != checksum (samples[i], size)) wrong++;
      if (!robot) {
        long tick = ((state_t *) samples[i])->tick;
        if (last >= 0 && tick != last + 2) gaps++;
        last = tick;
      } else if (((command_t *) samples[i])->motor_cmd[19].q != 2.146e9f) odd_offsets++;
    }
    if (taken > 0) dds_return_loan (reader, samples, taken);
    sent++;
    if (robot) { state_t s; fill_state (&s, 2u * (uint32_t) sent); dds_write (writer, &s); }
    else { command_t c; fill_command (&c, (uint32_t) sent); dds_write (writer, &c); }
    const dds_time_t wait = due + 2000000 - dds_time ();
    if (wait > 0) dds_sleepfor (wait); else due = dds_time ();
  }
  printf ("{\"sent\": %ld, \"received\": %ld, \"wrong\": %ld, \"gaps\": %ld, \"odd\": %ld}\n",
          sent, received, wrong, gaps, odd_offsets);
  dds_delete_qos (deep);
  dds_delete (participant);
  return 0;
}
