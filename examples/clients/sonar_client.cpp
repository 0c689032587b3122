// Ask a running `sonar-gym serve` for readings: g++ -std=c++17 -o sonar_client sonar_client.cpp && ./sonar_client [PORT]
// For little-endian machines, as almost all are.
#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

struct Ping { double distance, bearing, incidence, reflectance, time, sensor; };  // m, rad, rad, 1, s
struct Reading { double range, status, credence; };  // status: 0 no echo, 1 echo, 2 no answer

std::vector<Reading> ask(int server, const std::vector<Ping>& pings) {
    const uint32_t n = pings.size(), bytes = n * sizeof(Ping), head[4] = {12 + bytes, 0x474e4950 /* PING */, n, 0};
    uint32_t length = 0, answer[2];
    std::vector<Reading> readings(n);
    if (send(server, head, sizeof head, 0) < 0 || send(server, pings.data(), bytes, 0) < 0) return {};
    if (recv(server, &length, 4, MSG_WAITALL) != 4 || length != 8 + n * sizeof(Reading)) return {};
    if (recv(server, answer, 8, MSG_WAITALL) != 8 || std::memcmp(answer, "READ", 4) != 0) return {};
    const ssize_t size = n * sizeof(Reading);
    return recv(server, readings.data(), size, MSG_WAITALL) == size ? readings : std::vector<Reading>{};
}

int main(int argc, char** argv) {
    sockaddr_in address{AF_INET, htons(argc > 1 ? std::atoi(argv[1]) : 7715), {htonl(INADDR_LOOPBACK)}, {}};
    const int server = socket(AF_INET, SOCK_STREAM, 0);
    if (connect(server, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) return std::perror("connect"), 1;
    std::vector<Ping> pings;
    for (int k = 0; k < 8; ++k) pings.push_back({0.5 + 0.25 * k, 0.0, 0.0, 0.9, 0.0, double(k)});
    const auto readings = ask(server, pings);
    for (size_t k = 0; k < readings.size(); ++k)
        std::printf("true %.2f m, read %.2f m, status %.0f, credence %.2f\n", pings[k].distance, readings[k].range,
                    readings[k].status, readings[k].credence);
    return close(server), readings.empty() ? 1 : 0;
}
