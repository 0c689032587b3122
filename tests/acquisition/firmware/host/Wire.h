// The Wire library with simulated devices of 256 registers each; an address without a device is not acknowledged.
#pragma once
#include <map>
#include <set>
#include "Arduino.h"

enum HostFault { HOST_FINE, HOST_DATA_NACK, HOST_STUCK, HOST_SHORT };

struct HostWire {
  std::map<uint8_t, std::vector<uint8_t>> devices;
  std::string log;  // address, number of bytes and bytes of each write transaction
  int fault = HOST_FINE;
  bool begun = false, flag = false, reset = false;
  uint32_t clock = 0, timeout = 0;
  uint8_t address = 0, pointer = 0;
  std::vector<uint8_t> buffer, received;
  size_t taken = 0;

  void begin() { begun = true; }
  void setClock(uint32_t hertz) { clock = hertz; }
  void setWireTimeout(uint32_t us, bool again) { timeout = us, reset = again; }
  bool getWireTimeoutFlag() { return flag; }
  void clearWireTimeoutFlag() { flag = false; }
  void beginTransmission(uint8_t to) { address = to, buffer.clear(); }
  void write(uint8_t byte) { if (buffer.size() < 32) buffer.push_back(byte); }
  uint8_t endTransmission() {
    if (fault == HOST_STUCK) return flag = true, 5;
    if (!devices.count(address)) return 2;
    if (fault == HOST_DATA_NACK && !buffer.empty()) return 3;
    log += static_cast<char>(address);
    log += static_cast<char>(buffer.size());
    log.append(buffer.begin(), buffer.end());
    if (!buffer.empty()) pointer = buffer[0];
    for (size_t k = 1; k < buffer.size(); k++) devices[address][static_cast<uint8_t>(pointer + k - 1)] = buffer[k];
    return 0;
  }
  uint8_t requestFrom(uint8_t from, uint8_t count) {
    received.clear(), taken = 0;
    if (fault == HOST_STUCK) return flag = true, 0;
    if (fault == HOST_SHORT) count--;
    if (count > 32) count = 32;  // the library's buffer
    for (uint8_t k = 0; devices.count(from) && k < count; k++) received.push_back(devices[from][uint8_t(pointer + k)]);
    return static_cast<uint8_t>(received.size());
  }
  int read() { return taken < received.size() ? received[taken++] : -1; }
};
static HostWire Wire;

extern "C" {
void host_device(int address) {
  Wire.devices[address].resize(256);
  for (int k = 0; k < 256; k++) Wire.devices[address][k] = static_cast<uint8_t>(address + 3 * k);
}
int host_register(int address, int at) { return Wire.devices[address][at]; }
void host_fault(int fault) { Wire.fault = fault; }
void host_stuck_later() { Wire.flag = true; }
int host_log(char *into) {
  const int n = static_cast<int>(Wire.log.size());
  Wire.log.copy(into, n);
  Wire.log.clear();
  return n;
}
int host_wire(int what) { return what == 0 ? Wire.begun : what == 1 ? Wire.clock : what == 2 ? Wire.timeout : Wire.reset; }
}
