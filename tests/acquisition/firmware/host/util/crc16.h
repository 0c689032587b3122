#pragma once
#include <stdint.h>
// avr-libc, util/crc16.h, the equivalent in C that its manual gives
static inline uint16_t _crc_xmodem_update(uint16_t crc, uint8_t data) {
  crc ^= static_cast<uint16_t>(data) << 8;
  for (int k = 0; k < 8; k++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  return crc;
}
