// Counts the TRANSFORMs of a server, by the OpenIGTLink library: igtl_client PORT COUNT. For bench/igtl.py.
#include <igtlClientSocket.h>
#include <igtlMessageHeader.h>
#include <igtlTransformMessage.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>

int main(int, char *argv[]) {
  igtl::ClientSocket::Pointer socket = igtl::ClientSocket::New();
  if (socket->ConnectToServer("127.0.0.1", std::atoi(argv[1])) != 0) return 2;
  const int wanted = std::atoi(argv[2]);
  int good = 0, bad = 0;
  auto begin = std::chrono::steady_clock::now();
  while (good + bad < wanted) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (socket->Receive(header->GetPackPointer(), header->GetPackSize()) <= 0) break;
    header->Unpack();
    if (std::strcmp(header->GetDeviceType(), "TRANSFORM") != 0) {
      socket->Skip(header->GetBodySizeToRead(), 0);
      continue;
    }
    igtl::TransformMessage::Pointer message = igtl::TransformMessage::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
    (message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY ? good : bad)++;
  }
  std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
  std::printf("%d %d %.1f\n", good, bad, good / took.count());
  socket->CloseSocket();
  return 0;
}
