// The parts of the Arduino core that the sketch uses, simulated on the host with a clock that only reads advance.
// One sketch per shared library; the functions host_... are called by the tests.
#pragma once
#include <stdint.h>
#include <map>
#include <set>
#include <string>
#include <vector>

#define HIGH 1
#define LOW 0
#define INPUT 0
#define OUTPUT 1
#define NUM_DIGITAL_PINS 70
#define SDA 20
#define SCL 21

static uint64_t host_us = 0;
static uint8_t host_mode[256];
static uint8_t host_level[256];
// the echo line: level before the trigger; after its fall, the delay and width of the pulse, us
static int host_trigger = -1, host_echo = -1, host_idle = 0;
static uint64_t host_delay = 0, host_width = 0;
static int64_t host_fell = -1, host_rose = -1, host_lowered = -1;
// a line that pulses by itself
static int host_pulsing = -1;
static uint64_t host_period = 0, host_high = 0;

static inline uint32_t micros() { return static_cast<uint32_t>((host_us += 4) - 4); }
static inline void delayMicroseconds(unsigned int us) { host_us += us; }
static inline void pinMode(uint8_t pin, uint8_t mode) { host_mode[pin] = mode + 1; }

static inline void digitalWrite(uint8_t pin, uint8_t level) {
  if (pin == host_trigger) {
    if (level && !host_level[pin]) host_rose = host_us;
    if (!level && host_level[pin] && host_mode[pin] == OUTPUT + 1) host_fell = host_us;
    if (!level && host_lowered < 0) host_lowered = host_us;
  }
  host_level[pin] = level;
}

static inline int digitalRead(uint8_t pin) {
  host_us += 2;
  if (pin == host_pulsing) return host_us % host_period < host_high;
  if (pin != host_echo || host_mode[pin] != INPUT + 1) return LOW;
  if (host_fell < 0) return host_idle;
  const uint64_t since = host_us - host_fell;
  return since >= host_delay && since < host_delay + host_width;
}

struct HostSerial {
  std::string in, out;
  size_t at = 0;
  unsigned long baud = 0;
  void begin(unsigned long rate) { baud = rate; }
  int available() { return static_cast<int>(in.size() - at); }
  int read() { return static_cast<uint8_t>(in[at++]); }
  void write(char c) { out += c; }
  void write(const uint8_t *text, size_t n) { out.append(reinterpret_cast<const char *>(text), n); }
};
static HostSerial Serial;

void setup();
void loop();
extern "C" {
void host_setup() { setup(); }
int host_feed(const char *text, int n) {
  Serial.in.append(text, n);
  while (Serial.available()) loop();
  return static_cast<int>(Serial.out.size());
}
void host_idle_loop() { loop(); }
int host_take(char *into) {
  const int n = static_cast<int>(Serial.out.size());
  Serial.out.copy(into, n);
  Serial.out.clear();
  return n;
}
unsigned long host_baud() { return Serial.baud; }
void host_set_echo(int trigger, int echo, int idle, uint64_t delay, uint64_t width) {
  host_trigger = trigger, host_echo = echo, host_idle = idle, host_delay = delay, host_width = width;
  host_fell = host_rose = host_lowered = -1;
}
void host_set_pulses(int pin, uint64_t period, uint64_t high) { host_pulsing = pin, host_period = period, host_high = high; }
void host_set_time(uint64_t us) { host_us = us; }
int64_t host_time() { return host_us; }
int64_t host_trigger_low() { return host_rose < 0 || host_lowered < 0 ? -1 : host_rose - host_lowered; }
int64_t host_trigger_high() { return host_rose < 0 || host_fell < 0 ? -1 : host_fell - host_rose; }
int host_pin_mode(int pin) { return host_mode[pin] - 1; }
}
