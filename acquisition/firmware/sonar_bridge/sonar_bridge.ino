// Sonar bridge for the Arduino Mega 2560 (also Uno, Nano): access to I2C sonars (SRF08), HC-SR04 and the PW output of
// MaxBotix sensors over USB. The protocol is described in docs/reference/protocols.md: one line per request and per answer, each with a sequence number and a
// CRC-16. Every failure is answered with an error number; no request blocks, and no old value is returned.
#include <Arduino.h>
#include <Wire.h>
#include <stdlib.h>
#include <string.h>
#include <util/crc16.h>

const uint8_t PROTOCOL = 1;
const unsigned long BAUD = 115200;
const unsigned long WIRE_TIMEOUT_US = 25000;  // without it, a bus held low blocks the Wire library forever
const unsigned long RISE_US = 20000;          // an HC-SR04 raises its echo line within 1 ms of the trigger
const uint8_t CHUNK = 32;                     // size of the Wire library's buffer
const uint8_t MAX_READ = 36;                  // all registers of an SRF08
const uint8_t MAX_WRITTEN = 16;
const uint8_t MAX_LINE = 80;

// 1 to 5 are the errors of Wire.endTransmission: too long, address not acknowledged, data not acknowledged, other,
// timeout
enum Error : uint8_t {
  NO_ERROR = 0, WIRE_TIMEOUT = 5, SHORT_READ = 6,
  ECHO_HIGH = 16, NO_RISE = 17, NO_FALL = 18,
  BAD_REQUEST = 32, BAD_CHECKSUM = 33, UNKNOWN_COMMAND = 34
};

static char line[MAX_LINE + 1];
static uint8_t length = 0;
static bool overflow = false;
static char answer[MAX_LINE + 1];
static uint8_t used = 0;

static char digit(uint8_t value) { return value < 10 ? '0' + value : 'A' + value - 10; }

static void put(char c) {
  if (used < MAX_LINE) answer[used++] = c;
}

static void putHex(uint32_t value, uint8_t digits) {
  while (digits--) put(digit((value >> (4 * digits)) & 15));
}

static void begin(const char *sequence, char kind) {
  used = 0;
  put(sequence[0]);
  put(sequence[1]);
  put(' ');
  put(kind);
}

static uint16_t checksum(const char *text, uint8_t count) {
  uint16_t crc = 0xFFFF;
  while (count--) crc = _crc_xmodem_update(crc, *text++);
  return crc;
}

static void send() {
  const uint16_t crc = checksum(answer, used);
  Serial.write('<');
  Serial.write(reinterpret_cast<const uint8_t *>(answer), used);
  Serial.write('*');
  for (int8_t shift = 12; shift >= 0; shift -= 4) Serial.write(digit((crc >> shift) & 15));
  Serial.write('\n');
}

static void fail(const char *sequence, uint8_t error) {
  begin(sequence, 'E');
  put(' ');
  putHex(error, 2);
  send();
}

// Read the next hexadecimal number of a request; false if it is missing or above the limit.
static bool number(char *&at, uint32_t limit, uint32_t &value) {
  char *end;
  value = strtoul(at, &end, 16);
  const bool good = end != at && value <= limit;
  at = end;
  return good;
}

static uint8_t wireRead(uint8_t address, uint8_t from, uint8_t count, uint8_t *into) {
  while (count) {
    const uint8_t part = count < CHUNK ? count : CHUNK;
    Wire.beginTransmission(address);
    Wire.write(from);
    const uint8_t error = Wire.endTransmission();
    if (error) return error;
    if (Wire.requestFrom(address, part) != part) return Wire.getWireTimeoutFlag() ? WIRE_TIMEOUT : SHORT_READ;
    for (uint8_t k = 0; k < part; k++) *into++ = Wire.read();
    from += part;
    count -= part;
  }
  return NO_ERROR;
}

// W address byte...: one write transaction
static uint8_t write(char *at) {
  uint32_t address, value;
  uint8_t count = 0;
  if (!number(at, 0x7F, address)) return BAD_REQUEST;
  Wire.beginTransmission(static_cast<uint8_t>(address));
  while (*at) {
    if (!number(at, 0xFF, value) || ++count > MAX_WRITTEN) return BAD_REQUEST;
    Wire.write(static_cast<uint8_t>(value));
  }
  return count ? Wire.endTransmission() : static_cast<uint8_t>(BAD_REQUEST);
}

// R address register count: read registers; the answer is their bytes in hexadecimal
static uint8_t read(char *at) {
  uint32_t address, from, count;
  uint8_t block[MAX_READ];
  if (!number(at, 0x7F, address) || !number(at, 0xFF, from) || !number(at, MAX_READ, count) || !count || *at)
    return BAD_REQUEST;
  const uint8_t error = wireRead(address, from, count, block);
  if (error) return error;
  put(' ');
  for (uint8_t k = 0; k < count; k++) putHex(block[k], 2);
  return NO_ERROR;
}

static bool usable(uint32_t pin) {
  return pin >= 2 && pin < NUM_DIGITAL_PINS && pin != SDA && pin != SCL;
}

// Time a pulse that has just begun; the answer is its duration in microseconds
static uint8_t timed(uint8_t pin, uint32_t limit) {
  const unsigned long rose = micros();
  while (digitalRead(pin) == HIGH)
    if (micros() - rose > limit) return NO_FALL;
  put(' ');
  putHex(micros() - rose, 6);
  return NO_ERROR;
}

// D trigger echo limit: fire an HC-SR04; the answer is the pulse duration
static uint8_t distance(char *at) {
  uint32_t trigger, echo, limit;
  if (!number(at, 0xFF, trigger) || !number(at, 0xFF, echo) || !number(at, 500000UL, limit) || *at) return BAD_REQUEST;
  if (!usable(trigger) || !usable(echo) || trigger == echo) return BAD_REQUEST;
  pinMode(echo, INPUT);
  if (digitalRead(echo) == HIGH) return ECHO_HIGH;
  digitalWrite(trigger, LOW);
  pinMode(trigger, OUTPUT);
  delayMicroseconds(4);
  digitalWrite(trigger, HIGH);
  delayMicroseconds(12);
  digitalWrite(trigger, LOW);
  const unsigned long fired = micros();
  while (digitalRead(echo) == LOW)
    if (micros() - fired > RISE_US) return NO_RISE;
  return timed(echo, limit);
}

// P pin limit: wait for the next whole pulse of a sensor that pulses by itself; the answer is its duration
static uint8_t pulse(char *at) {
  uint32_t pin, limit;
  if (!number(at, 0xFF, pin) || !number(at, 500000UL, limit) || *at || !usable(pin)) return BAD_REQUEST;
  pinMode(pin, INPUT);
  const unsigned long begun = micros();
  while (digitalRead(pin) == HIGH)
    if (micros() - begun > limit) return NO_FALL;
  while (digitalRead(pin) == LOW)
    if (micros() - begun > limit) return NO_RISE;
  return timed(pin, limit);
}

// V: name and version of the protocol
static uint8_t version(char *at) {
  if (*at) return BAD_REQUEST;
  for (const char *text = " SONARBRIDGE "; *text; text++) put(*text);
  putHex(PROTOCOL, 2);
  return NO_ERROR;
}

struct Command {
  char name;
  uint8_t (*run)(char *);
};

static const Command COMMANDS[] = {{'V', version}, {'W', write}, {'R', read}, {'D', distance}, {'P', pulse}};

// Check and answer a line such as ">07 W 70 00 51*ABCD" (without its terminator).
static void serve() {
  char *star = strrchr(line, '*');
  if (overflow || !star || line[0] != '>' || strlen(star + 1) != 4 || star - line < 5 || line[3] != ' ' ||
      strtoul(star + 1, nullptr, 16) != checksum(line + 1, star - line - 1))
    return fail("--", BAD_CHECKSUM);
  *star = 0;
  const char *sequence = line + 1;
  for (const Command &command : COMMANDS) {
    if (command.name != line[4]) continue;
    Wire.clearWireTimeoutFlag();
    begin(sequence, 'K');
    const uint8_t error = command.run(line + 5);
    return error ? fail(sequence, error) : send();
  }
  fail(sequence, UNKNOWN_COMMAND);
}

void setup() {
  Serial.begin(BAUD);
  Wire.begin();
  Wire.setClock(100000);  // Devantech's sonars are specified for 100 kHz
  Wire.setWireTimeout(WIRE_TIMEOUT_US, true);
  begin("--", 'B');  // reports every reset to the host
  put(' ');
  putHex(PROTOCOL, 2);
  send();
}

void loop() {
  if (!Serial.available()) return;
  const char c = Serial.read();
  if (c == '\n') {
    line[length] = 0;
    if (length) serve();
    length = 0;
    overflow = false;
  } else if (length < MAX_LINE) {
    line[length++] = c;
  } else {
    overflow = true;
  }
}
