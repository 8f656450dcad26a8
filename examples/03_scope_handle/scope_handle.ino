// A scope handle for Carina (docs/scope-handle.md): firmware sketch for boards with Arduino's libraries.
// As it stands it is a serial port. With the next line it is a HID device instead, on boards that can be one (those with
// an ATmega32U4: Leonardo, Micro):
// #define HANDLE_AS_HID
// An optical mouse sensor (PMW3360 or the like) looks at the shaft: dy is insertion, dx is roll. A 10 kOhm
// potentiometer is the lever, two push buttons to ground. Put your sensor's driver where READ_SENSOR says so.

const int PIN_LEVER = A0;
const int PIN_BUTTON[2] = {2, 3};
const float MM_PER_COUNT = 25.4f / 1600.0f;  // a sensor set to 1600 counts per inch
const float SHAFT_RADIUS_MM = 2.95f;         // half the shaft's diameter: turns counts into degrees
const unsigned long PERIOD_MS = 8;           // 125 samples a second

float insertion_mm = 0.0f, roll_deg = 0.0f;
unsigned int number = 0;
unsigned long due_ms = 0;
bool sending = false;

// READ_SENSOR: counts since the last call, along the shaft and across it.
void read_sensor(int *along, int *across) {
  *along = 0;
  *across = 0;
}

#ifdef HANDLE_AS_HID
#include <HID.h>

// What the reports hold; the browser reads them by this.
static const unsigned char REPORT_DESCRIPTOR[] PROGMEM = {
    0x06, 0x42, 0xFF,              // usage page: 0xFF42, of no standard
    0x09, 0x01,                    // usage: scope handle
    0xA1, 0x01,                    // collection: application
    0x85, 0x01,                    //   report 1
    0x09, 0x21,                    //   clock, ms
    0x15, 0x00,                    //   from 0
    0x27, 0xFF, 0xFF, 0xFF, 0x7F,  //   to 2147483647
    0x75, 0x20, 0x95, 0x01,        //   32 bits, once
    0x81, 0x02,                    //   input: a value
    0x09, 0x22,                    //   insertion, 0.01 mm
    0x09, 0x23,                    //   roll, 0.01 degree
    0x17, 0x01, 0x1F, 0x0A, 0xFA,  //   from -99999999
    0x27, 0xFF, 0xE0, 0xF5, 0x05,  //   to 99999999
    0x95, 0x02,                    //   32 bits, twice
    0x81, 0x02,                    //   input: values
    0x09, 0x24,                    //   lever; its ends are the logical ones
    0x16, 0x18, 0xFC,              //   from -1000
    0x26, 0xE8, 0x03,              //   to 1000, fully down
    0x75, 0x10, 0x95, 0x01,        //   16 bits, once
    0x81, 0x02,                    //   input: a value
    0x05, 0x09,                    //   usage page: buttons
    0x19, 0x01, 0x29, 0x02,        //   1 and 2
    0x15, 0x00, 0x25, 0x01,        //   0 or 1
    0x75, 0x01, 0x95, 0x02,        //   1 bit, twice
    0x81, 0x02,                    //   input: values
    0x75, 0x06, 0x95, 0x01,        //   6 bits
    0x81, 0x03,                    //   input: nothing
    0xC0,                          // end of the collection
};

struct __attribute__((packed)) Report {
  unsigned long clock_ms;
  long insertion, roll;
  int16_t lever;
  unsigned char buttons;
};
#endif

unsigned char crc8(const char *text) {
  unsigned char value = 0;
  while (*text) {
    value ^= (unsigned char)*text++;
    for (int bit = 0; bit < 8; bit++) value = value & 0x80 ? (value << 1) ^ 0x07 : value << 1;
  }
  return value;
}

void setup() {
#ifdef HANDLE_AS_HID
  static HIDSubDescriptor node(REPORT_DESCRIPTOR, sizeof REPORT_DESCRIPTOR);
  HID().AppendDescriptor(&node);
  sending = true;
#endif
  Serial.begin(115200);
  pinMode(PIN_BUTTON[0], INPUT_PULLUP);
  pinMode(PIN_BUTTON[1], INPUT_PULLUP);
}

void listen() {
  while (Serial.available()) {
    switch (Serial.read()) {
      case '?': Serial.println("# scope handle sketch 1"); break;
      case 'G': sending = true; break;
      case 'H': sending = false; break;
      case 'Z': insertion_mm = roll_deg = 0.0f; break;
    }
  }
}

void loop() {
  listen();
  int along, across;
  read_sensor(&along, &across);
  insertion_mm += along * MM_PER_COUNT;
  roll_deg += across * MM_PER_COUNT / SHAFT_RADIUS_MM * 57.29578f;
  if (!sending || (long)(millis() - due_ms) < 0) return;
  due_ms = millis() + PERIOD_MS;
  int lever = map(analogRead(PIN_LEVER), 0, 1023, -1000, 1000);
  int buttons = (digitalRead(PIN_BUTTON[0]) == LOW) | (digitalRead(PIN_BUTTON[1]) == LOW) << 1;
#ifdef HANDLE_AS_HID
  Report report = {millis() & 0x7FFFFFFFUL, lroundf(insertion_mm * 100), lroundf(roll_deg * 100), (int16_t)lever,
                   (unsigned char)buttons};
  HID().SendReport(1, &report, sizeof report);
  return;
#endif
  char line[72];
  snprintf(line, sizeof line, "S,%u,%lu,%ld,%ld,%d,%X", number++ & 0xFFFF, millis(), lroundf(insertion_mm * 100),
           lroundf(roll_deg * 100), lever, buttons);
  Serial.print(line);
  snprintf(line, sizeof line, "*%02X", crc8(line));
  Serial.println(line);
}
