// Asks a running `preshape serve` for a plan and prints plan.json: client HOST PORT [REQUEST]
#include <netdb.h>
#include <unistd.h>
#include <iostream>
#include <string>

int main(int count, char** given) {
    const std::string body = count > 3 ? given[3] : R"({"object": "mug", "task": "pour", "hand": "shadow"})";
    addrinfo hints{}, *found = nullptr;
    hints.ai_socktype = SOCK_STREAM;
    if (count < 3 || getaddrinfo(given[1], given[2], &hints, &found)) return 2;
    const int server = socket(found->ai_family, found->ai_socktype, 0);
    if (connect(server, found->ai_addr, found->ai_addrlen)) return 3;
    const std::string request = "POST /plan HTTP/1.0\r\nHost: " + std::string(given[1]) + ":" + given[2] +
        "\r\nContent-Length: " + std::to_string(body.size()) + "\r\n\r\n" + body;
    if (write(server, request.data(), request.size()) < 0) return 3;
    std::string answer;
    char part[4096];
    for (ssize_t size; (size = read(server, part, sizeof part)) > 0;) answer.append(part, size);
    std::cout << answer.substr(answer.find("\r\n\r\n") + 4) << "\n";
    return answer.find(" 200 ") == 8 ? 0 : 1;
}
