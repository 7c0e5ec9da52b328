/* A controller that speaks the reference link, written from docs/protocol.md alone. Numbers in comments are its clauses.

   It has no kinematics and no fieldbus: its arm is a portal, whose joints 1…3 are x, y, z and 4…6 a rotation vector,
   and which follows what is commanded with a lag. Put a machine in place of arm_step(), and its model in place of
   publish_joints(). Clause 11 is not implemented, which 3.4 allows: a signed datagram is dropped by its critical flag.

   cc -std=c11 -O2 -Wall -Wextra -o controller controller.c -lm && ./controller [PORT]   (0: any; it prints which) */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <math.h>
#include <poll.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "fields are copied as they lie: 1.1 is little-endian");

enum { HEADER = 40, MAX_DATAGRAM = 1440, WAYPOINTS = 24, ANSWERS = 256, NONCES = 64, QUEUE = 64, WINDOW = 64 };
/* What the page leaves to the controller; -DOTHERWISE chooses all of it otherwise. */
#ifdef OTHERWISE
enum { CYCLE_MS = 8, LINK_TIMEOUT_MS = 400, LEAST_PERIOD_MS = 2 * CYCLE_MS, PERIOD_STEP_MS = CYCLE_MS, SECOND_THOUGHTS = 1 };
static const unsigned long long FIRST_CYCLE = 0xFFFFFFFFull - 50, CLOCK_ADDS = 0x8000000000000000ull - 1060000000000ull;
static const unsigned FIRST_SEQUENCE = 0xFFFFFFF0u, FIRST_COUNT = 0xFFFFFFFEu;
static const double FAR[2] = {0.4, 0.4}, TWIST = 0.6 / 1.7320508, GREATEST_AGE_S = 0.2, RAMP_S = 0.4, LAG_S = 0.08,
                    SHORTEST_S = 0.1, LONGEST_S = 200, FIRST_POSE_M = 2.5;
#else
enum { CYCLE_MS = 5, LINK_TIMEOUT_MS = 250, LEAST_PERIOD_MS = 0, PERIOD_STEP_MS = 1, SECOND_THOUGHTS = 0 };
static const unsigned long long FIRST_CYCLE = 0, CLOCK_ADDS = 0;
static const unsigned FIRST_SEQUENCE = 0, FIRST_COUNT = 0;
static const double FAR[2] = {0.5, 0.5236}, TWIST = 0.8 / 1.7320508, GREATEST_AGE_S = 0.25, RAMP_S = 0.25, LAG_S = 0.05,
                    SHORTEST_S = 0.01, LONGEST_S = 600, FIRST_POSE_M = INFINITY;
#endif
enum { RATION_MS = 50, GREATEST_GAP = 65536 };
enum { HELLO = 1, WELCOME, HEARTBEAT, HEARTBEAT_REPLY, REFERENCE_POSE, REFERENCE_PATH, COMMAND, ACKNOWLEDGEMENT, STATE,
       BYE, STREAMED_POSE, STREAM_REFUSED, KINDS };
static const int PAYLOAD[KINDS] = {0, 32, 48, 8, 24, 72, 1376, 16, 32, 336, 8, 128, 32};
enum { PATHS = 1, STREAMING_CAPABILITY = 2 };
enum { ENABLE = 1, DISABLE, STOP, RESET, EMERGENCY_STOP, EMERGENCY_RELEASE, START_STREAM, END_STREAM, REFERENCE,
       STREAMED, COLUMNS };
enum { ACCEPTED = 0, GROUP_DISABLED = 1, NOT_IN_ERROR = 2, ERROR_LATCHED = 3, EMERGENCY_LATCHED = 4, IS_STOPPING = 5,
       ALREADY_DONE = 6, NOT_FINITE = 10, NOT_UNIT_QUATERNION = 11, OUTSIDE_WORKSPACE = 12, TOO_FAST = 16, TOO_FAR = 17,
       BAD_DURATION = 18, EMPTY_PATH = 19, TOO_MANY_WAYPOINTS = 20, UNKNOWN_COMMAND = 24, REPEATED_COMMAND_ID = 25,
       OVERTAKEN = 26, NOT_NEGOTIATED = 27, IS_MOVING = 28, IS_STREAMING = 29, NOT_STREAMING = 30, STALE = 31,
       INCOMPATIBLE_VERSION = 40, WRONG_ARM = 41, SESSION_OCCUPIED = 42, UNKNOWN_SESSION = 43, LINK_TIMEOUT = 45, KEY_NOT_CONFIGURED = 48 };
enum { NO_FAULT = 0, REFERENCE_LINK_LOST = 3, FAULT_EMERGENCY = 12, REFERENCE_STALE = 16 };
enum { SEVERITY_STOP = 2, SEVERITY_EMERGENCY = 3 };

/* Modes are finer than the states of STATE (7.3). */
enum { DISABLED, STANDBY, MOVING, STREAMING, STOPPING, DISABLING, ERROR_RAMP, ERROR_HELD, EMERGENCY, MODES };
static const int GROUP_STATE[MODES] = {0, 1, 2, 2, 3, 3, 4, 4, 4};
typedef struct { int next, reason; } Row;
static const Row TABLE[MODES][COLUMNS] = { /* 7.3; the first column of each row is not a command */
  [DISABLED] = {{0, 0}, {STANDBY, 0}, {DISABLED, 6}, {DISABLED, 0}, {DISABLED, 2}, {EMERGENCY, 0}, {DISABLED, 6},
                {DISABLED, 1}, {DISABLED, 30}, {DISABLED, 1}, {DISABLED, 1}},
  [STANDBY] = {{0, 0}, {STANDBY, 6}, {DISABLED, 0}, {STANDBY, 0}, {STANDBY, 2}, {EMERGENCY, 0}, {STANDBY, 6},
               {STREAMING, 0}, {STANDBY, 30}, {MOVING, 0}, {STANDBY, 30}},
  [MOVING] = {{0, 0}, {MOVING, 6}, {DISABLING, 0}, {STOPPING, 0}, {MOVING, 2}, {EMERGENCY, 0}, {MOVING, 6},
              {MOVING, 28}, {MOVING, 30}, {MOVING, 0}, {MOVING, 30}},
  [STREAMING] = {{0, 0}, {STREAMING, 6}, {DISABLING, 0}, {STOPPING, 0}, {STREAMING, 2}, {EMERGENCY, 0}, {STREAMING, 6},
                 {STREAMING, 29}, {MOVING, 0}, {STREAMING, 29}, {STREAMING, 0}},
  [STOPPING] = {{0, 0}, {STOPPING, 6}, {DISABLING, 0}, {STOPPING, 0}, {STOPPING, 2}, {EMERGENCY, 0}, {STOPPING, 6},
                {STOPPING, 5}, {STOPPING, 30}, {STOPPING, 5}, {STOPPING, 5}},
  [DISABLING] = {{0, 0}, {DISABLING, 5}, {DISABLING, 6}, {DISABLING, 0}, {DISABLING, 2}, {EMERGENCY, 0},
                 {DISABLING, 6}, {DISABLING, 5}, {DISABLING, 30}, {DISABLING, 5}, {DISABLING, 5}},
  [ERROR_RAMP] = {{0, 0}, {ERROR_RAMP, 3}, {ERROR_RAMP, 3}, {ERROR_RAMP, 0}, {ERROR_RAMP, 5}, {EMERGENCY, 0},
                  {ERROR_RAMP, 6}, {ERROR_RAMP, 3}, {ERROR_RAMP, 30}, {ERROR_RAMP, 3}, {ERROR_RAMP, 3}},
  [ERROR_HELD] = {{0, 0}, {ERROR_HELD, 3}, {ERROR_HELD, 6}, {ERROR_HELD, 0}, {DISABLED, 0}, {EMERGENCY, 0},
                  {ERROR_HELD, 6}, {ERROR_HELD, 3}, {ERROR_HELD, 30}, {ERROR_HELD, 3}, {ERROR_HELD, 3}},
  [EMERGENCY] = {{0, 0}, {EMERGENCY, 4}, {EMERGENCY, 6}, {EMERGENCY, 0}, {EMERGENCY, 4}, {EMERGENCY, 6},
                 {ERROR_HELD, 0}, {EMERGENCY, 4}, {EMERGENCY, 30}, {EMERGENCY, 4}, {EMERGENCY, 4}},
};

typedef uint8_t Byte;
typedef struct { int reason; double value, limit; } Decision;
typedef struct { uint64_t id; uint32_t content; bool decided; Decision answer; } Entry;
typedef struct {                       /* a session, or the grant of one that has not begun (4.2) */
  uint64_t number, nonce, hello_sent_ns, capabilities, granted_ns, heard_ns;
  uint64_t received;                   /* bit k: the number `newest` − k has come */
  uint32_t newest, sequence, lost, dropped, period_ms;
  int64_t least[2]; uint64_t slot_ns;  /* least d of this 10 s and of the 10 s before (5.3) */
  uint64_t newest_id, state_ns; Entry answers[ANSWERS]; unsigned answered;
  struct sockaddr_in source; Byte minor;
} Session;
typedef struct { int kind; uint64_t id; Byte payload[1376]; } Request;

static int udp;
static Session open_session, grant;
static uint64_t boot_id, ended_nonces[NONCES], rationed_ns;
static unsigned ended_count;
static Request queue[QUEUE]; static int queued;
static Byte streamed[128]; static bool streamed_waits;
static uint64_t streamed_left_ns, streamed_age_ns;

/* The group and its arm: six axes, each with place, speed and acceleration as commanded, and a place as measured. */
static int mode, fault, severity; static bool session_ended;
static uint64_t cycle, scan_ns, motion_id; static uint32_t overruns; static bool arrived, motion_done;
static double at[6] = {3.5, 0, 1.2}, speed[6], acceleration[6], measured[6] = {3.5, 0, 1.2};
static double base_q[4] = {0, 0.7071067811865476, 0, 0.7071067811865476}; /* axes 4…6 turn from here, in B */
static double ramp_s, ramp_from[6];
static struct { double from[6], v[6], a[6], to[WAYPOINTS][6]; int count, segment; double t, T[WAYPOINTS], dwell_s; } path;
static struct { uint64_t id, fresh_ns, begun_ns, at_ns; uint32_t number; bool any; double to[6], twist[6], pace; } stream;
static bool approaching; /* MOVING after END_STREAM */

static const double SPEED[2] = {0.25, 0.21}, ACCELERATION[2] = {0.35, 0.35}, JERK[2] = {3.0, 2.6}; /* m, rad */
static const double AXIS = 1 / 1.7320508; /* the bounds of clause 12 are those of the vector */
static const double LOW[3] = {1.0, -3.0, -1.0}, HIGH[3] = {6.0, 3.0, 4.0};
static const int SILENCE_MS = 100, STREAM_RAMP_MS = 12, RECOVERY_MS = 100, FIRST_REFERENCE_MS = 1000;

#define GET(type, from, offset) ({ type value_; memcpy(&value_, (from) + (offset), sizeof value_); value_; })
#define PUT(type, to, offset, value) do { type value_ = (value); memcpy((to) + (offset), &value_, sizeof value_); } while (0)

static uint64_t machine_ns(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void by_udp(const Byte *d, size_t n, const struct sockaddr_in *to) {
  sendto(udp, d, n, 0, (const struct sockaddr *)to, sizeof *to);
}

/* The clock and the way out: a test puts its own in their place and calls receive and scan itself. */
uint64_t (*now_ns)(void) = machine_ns;
void (*transmit)(const Byte *d, size_t n, const struct sockaddr_in *to) = by_udp;

static uint64_t clock_ns(void) { return now_ns() + CLOCK_ADDS; } /* from any start (1.7) */

static uint64_t drawn(void) { /* not 0, and not to be computed (4.2) */
  uint64_t number = 0;
  while (!number) if (getrandom(&number, sizeof number, 0) != sizeof number) number = 0;
  return number;
}

static uint32_t crc(const Byte *data, size_t n, uint32_t seed) { /* 3.2 */
  for (; n--; data++) {
    seed ^= *data;
    for (int k = 0; k < 8; k++) seed = seed >> 1 ^ (seed & 1 ? 0xEDB88320u : 0);
  }
  return seed;
}

static uint32_t sealed(const Byte *d, size_t n) { return ~crc(d + 16, n - 16, crc(d, 12, 0xFFFFFFFFu)); }

static void send_to(const struct sockaddr_in *to, int kind, const Byte *payload, uint64_t session, uint32_t sequence,
                    Byte minor, const Session *echo) {
  Byte d[MAX_DATAGRAM] = "LRLK";
  d[4] = 1, d[5] = minor, d[6] = (Byte)kind;
  PUT(uint16_t, d, 8, echo ? 1 : 0);
  PUT(uint16_t, d, 10, (uint16_t)PAYLOAD[kind]);
  PUT(uint64_t, d, 16, session);
  PUT(uint32_t, d, 24, sequence);
  PUT(uint32_t, d, 28, echo ? echo->newest : 0);
  PUT(uint64_t, d, 32, clock_ns());
  memcpy(d + HEADER, payload, (size_t)PAYLOAD[kind]);
  PUT(uint32_t, d, 12, sealed(d, (size_t)(HEADER + PAYLOAD[kind])));
  transmit(d, (size_t)(HEADER + PAYLOAD[kind]), to);
}

static void send_in(Session *s, int kind, const Byte *payload) {
  send_to(&s->source, kind, payload, s->number, FIRST_SEQUENCE + s->sequence++, s->minor, SECOND_THOUGHTS ? NULL : s); /* 5.7 */
}

static bool refuse(const struct sockaddr_in *to, uint64_t session, int reason, uint64_t now) { /* 4.4 */
  if (now - rationed_ns < RATION_MS * 1000000ull) return false;
  rationed_ns = now;
  Byte bye[8] = {(Byte)reason};
  send_to(to, BYE, bye, session, 0, 0, NULL);
  return false;
}

static void forget(Session *s) {
  if (s->nonce) ended_nonces[ended_count++ % NONCES] = s->nonce; /* 4.6 */
  memset(s, 0, sizeof *s);
}

static bool is_stop(const Request *r) {
  uint32_t code = GET(uint32_t, r->payload, 8);
  return r->kind == COMMAND && (code == STOP || code == DISABLE || code == EMERGENCY_STOP);
}

static Decision judge(const Request *r);
static struct { uint64_t id; Decision d; } later[QUEUE]; static int waiting; /* answers that go out behind STATE */

static void end_session(int reason) { /* what was set in motion in it ends in the next scan (7.5) */
  Byte bye[8] = {(Byte)reason};
  for (int k = 0; k < queued; k++)
    if (is_stop(&queue[k])) judge(&queue[k]); /* still judged (6.12), answered to nobody */
  if (reason) send_in(&open_session, BYE, bye);
  waiting = 0;
  forget(&open_session);
  session_ended = true;
  queued = 0;
}

/* ---- requests: at most once, one decision each (6.2) ---- */

static void acknowledge(uint64_t id, Decision d) {
  Byte p[32] = {0};
  PUT(uint64_t, p, 0, id); PUT(uint32_t, p, 8, (uint32_t)d.reason); PUT(double, p, 16, d.value); PUT(double, p, 24, d.limit);
  send_in(&open_session, ACKNOWLEDGEMENT, p);
}

static void answer_now(void) {
  for (int k = 0; k < waiting; k++) acknowledge(later[k].id, later[k].d);
  waiting = 0;
}

static void decide(uint64_t id, Decision d) {
  for (int k = 0; k < ANSWERS; k++)
    if (open_session.answers[k].id == id) open_session.answers[k].decided = true, open_session.answers[k].answer = d;
  if (waiting == QUEUE) answer_now();
  later[waiting].id = id, later[waiting++].d = d;
  if (!SECOND_THOUGHTS) answer_now();
}

static Decision overtaken(uint64_t id, uint64_t by) { return (Decision){OVERTAKEN, (double)id, (double)by}; }

static void enqueue(int kind, uint64_t id, const Byte *payload) {
  if (queued == QUEUE) { /* 6.14: the oldest that is no stop gives way; of stops alone, one followed by its like */
    int out = 0;
    while (out < QUEUE && is_stop(&queue[out])) out++;
    for (int k = 0; out == QUEUE && k < QUEUE; k++)
      for (int later = k + 1; later < QUEUE; later++)
        if (queue[k].payload[8] == queue[later].payload[8]) { out = k; break; }
    decide(queue[out].id, overtaken(queue[out].id, id));
    memmove(&queue[out], &queue[out + 1], (size_t)(--queued - out) * sizeof *queue);
  }
  queue[queued].kind = kind, queue[queued].id = id;
  memcpy(queue[queued++].payload, payload, (size_t)PAYLOAD[kind]);
}

static Decision impossible(int kind, const Byte *p) { /* 3.6, then the capability (6.10) */
  uint32_t code = kind == COMMAND ? GET(uint32_t, p, 8) : REFERENCE, count = kind == REFERENCE_PATH ? GET(uint32_t, p, 8) : 1;
  if (kind == COMMAND && (code < ENABLE || code > END_STREAM)) return (Decision){UNKNOWN_COMMAND, code, 0};
  if (count == 0) return (Decision){EMPTY_PATH, 0, 1};
  if (count > WAYPOINTS) return (Decision){TOO_MANY_WAYPOINTS, count, WAYPOINTS};
  uint64_t needs = kind == REFERENCE_PATH ? PATHS : code == START_STREAM || code == END_STREAM ? STREAMING_CAPABILITY : 0;
  return (Decision){(open_session.capabilities & needs) == needs ? ACCEPTED : NOT_NEGOTIATED, 0, 0};
}

static void admit(int kind, const Byte *payload) { /* 6.2 to 6.5 */
  Session *s = &open_session;
  Byte without_padding[1376];
  memcpy(without_padding, payload, (size_t)PAYLOAD[kind]);
  if (kind != REFERENCE_POSE) memset(without_padding + 12, 0, 4); /* 1.8 */
  uint32_t used = kind == REFERENCE_PATH ? GET(uint32_t, payload, 8) : WAYPOINTS;
  if (used < WAYPOINTS) memset(without_padding + 16 + 56 * used, 0, 56 * (WAYPOINTS - used)); /* 6.8 */
  uint64_t id = GET(uint64_t, payload, 0);
  uint32_t content = crc(without_padding, (size_t)PAYLOAD[kind], (uint32_t)kind);
  for (int k = 0; k < ANSWERS; k++)
    if (s->answers[k].id == id) {
      if (s->answers[k].content != content) acknowledge(id, (Decision){REPEATED_COMMAND_ID, 0, 0});
      else if (s->answers[k].decided) acknowledge(id, s->answers[k].answer);
      return;
    }
  if (id < s->newest_id) { acknowledge(id, overtaken(id, s->newest_id)); return; }
  s->newest_id = id;
  s->answers[s->answered++ % ANSWERS] = (Entry){id, content, false, {0, 0, 0}};
  Decision d = impossible(kind, payload);
  if (d.reason) decide(id, d); /* before it waits: it overtakes nothing (6.6) */
  else enqueue(kind, id, payload);
}

/* ---- datagrams: checked in the order of 3.5, dropped at the first check that fails ---- */

static bool subnormal_or_not_finite(const Byte *from, int count) { /* 3.7 */
  for (int k = 0; k < count; k++) {
    int class = fpclassify(GET(double, from, 8 * k));
    if (class != FP_NORMAL && class != FP_ZERO) return true;
  }
  return false;
}

static bool same(const struct sockaddr_in *a, const struct sockaddr_in *b) {
  return a->sin_addr.s_addr == b->sin_addr.s_addr && a->sin_port == b->sin_port;
}

static bool bad_value(int kind, const Byte *p) {
  if (kind == HELLO) return !GET(uint64_t, p, 0) || GET(uint32_t, p, 24) > 60000;
  if (kind == BYE) {
    uint32_t r = GET(uint32_t, p, 0);
    return !(r <= 6 || (r >= 10 && r <= 31) || (r >= 40 && r <= 50));
  }
  return kind >= REFERENCE_POSE && kind != STATE && !GET(uint64_t, p, 0);
}

static bool in_order(Session *s, uint32_t number) { /* 5.2; moves the count */
  int32_t ahead = (int32_t)(number - s->newest);
  if (ahead <= 0) {
    uint64_t bit = ahead > -WINDOW ? 1ull << -ahead : 0;
    if (bit && !(s->received & bit)) s->received |= bit, s->lost -= s->lost > 0;
    return false;
  }
  if (ahead > GREATEST_GAP) return false;
  s->lost += (uint32_t)ahead - 1;
  s->received = ahead < WINDOW ? s->received << ahead | 1 : 1;
  s->newest = number;
  return true;
}

static uint64_t age_ns(Session *s, uint64_t sent, uint64_t now) { /* 5.3 */
  int64_t d = (int64_t)(now - sent);
  if (now - s->slot_ns > 10000000000ull) s->slot_ns = now, s->least[1] = s->least[0], s->least[0] = d;
  if (d < s->least[0]) s->least[0] = d;
  return (uint64_t)(d - (s->least[0] < s->least[1] ? s->least[0] : s->least[1]));
}

static void welcome(Session *s) {
  Byte p[48] = {0};
  if (!boot_id) boot_id = drawn();
  PUT(uint64_t, p, 0, s->nonce); PUT(uint64_t, p, 8, s->capabilities); PUT(uint64_t, p, 16, 0x4C4F4E4752454143ull);
  PUT(uint64_t, p, 24, boot_id); PUT(uint32_t, p, 32, CYCLE_MS * 1000000u); PUT(uint32_t, p, 36, LINK_TIMEOUT_MS);
  PUT(uint32_t, p, 40, s->period_ms);
  send_in(s, WELCOME, p);
}

static uint32_t granted_ms(uint32_t asked) { /* 4.2 */
  int ms = (int)asked;
  return (uint32_t)(ms < LEAST_PERIOD_MS ? LEAST_PERIOD_MS : ms > 50000 ? ms : (ms + PERIOD_STEP_MS - 1) / PERIOD_STEP_MS * PERIOD_STEP_MS);
}

static bool hello(const Byte *d, const struct sockaddr_in *from, uint64_t now) {
  const Byte *p = d + HEADER;
  uint64_t nonce = GET(uint64_t, p, 0), sent = GET(uint64_t, d, 32), arm = GET(uint64_t, p, 16);
  if (GET(uint64_t, d, 16)) return false;
  bool connected = open_session.number && same(from, &open_session.source);
  Session *again = connected && nonce == open_session.nonce ? &open_session
                   : grant.number && same(from, &grant.source) && nonce == grant.nonce ? &grant : NULL;
  if (again) { /* judged by its number and age alone (3.5) */
    if (!in_order(again, GET(uint32_t, d, 24)) || age_ns(again, sent, now) > LINK_TIMEOUT_MS * 1000000ull) return false;
    welcome(again);
    return true;
  }
  for (int k = 0; k < NONCES; k++) if (ended_nonces[k] == nonce) return false;
  if (connected && nonce != open_session.nonce && sent < open_session.hello_sent_ns) return false;
  if (arm && arm != 0x4C4F4E4752454143ull) return refuse(from, 0, WRONG_ARM, now);
  if (open_session.number && !connected) return refuse(from, 0, SESSION_OCCUPIED, now);
  if (grant.number && same(from, &grant.source) && sent < grant.hello_sent_ns) return false;
  forget(&grant);
  grant.number = drawn(), grant.nonce = nonce, grant.hello_sent_ns = sent, grant.granted_ns = now;
  grant.capabilities = GET(uint64_t, p, 8) & (PATHS | STREAMING_CAPABILITY), grant.period_ms = granted_ms(GET(uint32_t, p, 24));
  grant.newest = GET(uint32_t, d, 24), grant.received = 1, grant.slot_ns = now, grant.source = *from;
  grant.least[0] = grant.least[1] = (int64_t)(now - sent);
  welcome(&grant);
  return true;
}

static void heartbeat(const Byte *p, uint64_t received_ns) { /* 5.5 */
  Byte reply[24];
  memcpy(reply, p, 8);
  PUT(uint64_t, reply, 8, received_ns); PUT(uint64_t, reply, 16, clock_ns());
  send_in(&open_session, HEARTBEAT_REPLY, reply);
}

static bool newer_in_stream(const Byte *p) { /* of several that wait, the newest by number (12.3) */
  return !streamed_waits || memcmp(p, streamed, 8) || (int32_t)(GET(uint32_t, p, 8) - GET(uint32_t, streamed, 8)) > 0;
}

static bool receive(const Byte *d, size_t n, const struct sockaddr_in *from, uint64_t now) { /* whether it was used */
  if (n < HEADER || n > MAX_DATAGRAM || memcmp(d, "LRLK", 4)) return false;
  if (d[4] != 1) return refuse(from, 0, INCOMPATIBLE_VERSION, now);
  uint16_t flags = GET(uint16_t, d, 8);
  int kind = d[6];
  if (GET(uint16_t, d, 10) != n - HEADER - (flags & 0x100 ? 24 : 0) || GET(uint32_t, d, 12) != sealed(d, n)) return false;
  if (kind == HELLO && flags & 0x100 && n == HEADER + 32 + 24) return refuse(from, 0, KEY_NOT_CONFIGURED, now);
  if (flags & 0xFF00 || kind < 1 || kind >= KINDS || n != (size_t)(HEADER + PAYLOAD[kind])) return false;
  const Byte *p = d + HEADER;
  uint64_t number = GET(uint64_t, d, 16), sent = GET(uint64_t, d, 32);
  if (bad_value(kind, p)) return false;
  if (kind == HELLO) return hello(d, from, now);
  if (grant.number && now - grant.granted_ns > LINK_TIMEOUT_MS * 1000000ull) forget(&grant);
  Session *s = number && number == open_session.number ? &open_session : number && number == grant.number ? &grant : NULL;
  if (!s) return kind != BYE && refuse(from, number, UNKNOWN_SESSION, now);
  if (!same(from, &s->source) || d[5] != s->minor) return false;
  if (kind == BYE) {
    if (s == &grant) forget(&grant); else end_session(0);
    return true;
  }
  bool ours = kind == HEARTBEAT || (kind >= REFERENCE_POSE && kind <= COMMAND) || kind == STREAMED_POSE;
  if (!ours || !in_order(s, GET(uint32_t, d, 24))) return false;
  uint64_t age = age_ns(s, sent, now);
  if (age > LINK_TIMEOUT_MS * 1000000ull) return false;
  if (s == &grant) { /* the session begins (4.2) */
    Session begun = grant;
    memset(&grant, 0, sizeof grant);
    if (open_session.number) end_session(0);
    open_session = begun, s = &open_session;
  }
  s->heard_ns = now - age; /* 5.4 */
  if (kind == HEARTBEAT) heartbeat(p, now);
  else if (kind != STREAMED_POSE) admit(kind, p);
  else if (newer_in_stream(p)) {
    int64_t rests = (int64_t)(sent - GET(uint64_t, p, 16)); /* its age when it left (12.6) */
    memcpy(streamed, p, 128), streamed_waits = true, streamed_left_ns = now - age;
    streamed_age_ns = (uint64_t)(rests > 0 ? rests : 0);
  }
  return true;
}

/* ---- the arm: a portal ---- */

static void product(const double *a, const double *b, double *c) {
  double w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  double x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  double y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  double z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
  c[0] = w, c[1] = x, c[2] = y, c[3] = z;
}

static void pose_of(const double *axes, double *pose) { /* x, y, z, qw, qx, qy, qz */
  double angle = sqrt(axes[3] * axes[3] + axes[4] * axes[4] + axes[5] * axes[5]);
  double s = angle > 1e-12 ? sin(angle / 2) / angle : 0.5;
  double turn[4] = {cos(angle / 2), s * axes[3], s * axes[4], s * axes[5]};
  memcpy(pose, axes, 3 * sizeof *pose);
  product(turn, base_q, pose + 3);
}

static void axes_of(const double *pose, double *axes) {
  double norm = sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6]);
  double q[4], back[4] = {base_q[0], -base_q[1], -base_q[2], -base_q[3]}, turn[4];
  for (int k = 0; k < 4; k++) q[k] = pose[3 + k] / norm;
  product(q, back, turn);
  if (turn[0] < 0) for (int k = 0; k < 4; k++) turn[k] = -turn[k]; /* 1.5 */
  double s = sqrt(turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3]);
  double scale = s > 1e-12 ? 2 * atan2(s, turn[0]) / s : 2;
  memcpy(axes, pose, 3 * sizeof *axes);
  for (int k = 0; k < 3; k++) axes[3 + k] = scale * turn[1 + k];
}

static Decision is_pose(const Byte *from, int index, int count) { /* 1.5, 3.7 */
  if (subnormal_or_not_finite(from, 7)) return (Decision){NOT_FINITE, index, count};
  double q[4];
  memcpy(q, from + 24, sizeof q);
  double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  return fabs(norm - 1) > 1e-3 ? (Decision){NOT_UNIT_QUATERNION, norm, 1} : (Decision){ACCEPTED, 0, 0};
}

static Decision place_fits(const double *pose) {
  for (int k = 0; k < 3; k++) {
    if (pose[k] < LOW[k]) return (Decision){OUTSIDE_WORKSPACE, pose[k], LOW[k]};
    if (pose[k] > HIGH[k]) return (Decision){OUTSIDE_WORKSPACE, pose[k], HIGH[k]};
  }
  return (Decision){ACCEPTED, 0, 0};
}

static double largest(const double *a, const double *b, int from) {
  double most = 0;
  for (int k = from; k < from + 3; k++) most = fmax(most, fabs(a[k] - b[k]));
  return most;
}

/* ---- motions ---- */

static double time_for(const double *from, const double *to) { /* peak of the quintic: 1.875 of the mean speed */
  double way = fmax(largest(from, to, 0) / SPEED[0], largest(from, to, 3) / SPEED[1]);
  double bend = fmax(largest(from, to, 0) / ACCELERATION[0], largest(from, to, 3) / ACCELERATION[1]);
  return fmax(0.2, fmax(1.875 * 1.75 * way, sqrt(5.774 * bend)));
}

static void begin_segment(void) {
  memcpy(path.from, at, sizeof at), memcpy(path.v, speed, sizeof at), memcpy(path.a, acceleration, sizeof at);
  path.t = 0;
}

static Decision timed(double given, const double *from, const double *to, double *T) {
  *T = time_for(from, to);
  if (given == 0) return (Decision){ACCEPTED, 0, 0};
  if (given < *T) return (Decision){TOO_FAST, *T / given, 1};
  *T = given;
  return (Decision){ACCEPTED, 0, 0};
}

static Decision times_fit(double seconds, double dwell_s) {
  if (subnormal_or_not_finite((Byte *)&seconds, 1) || subnormal_or_not_finite((Byte *)&dwell_s, 1))
    return (Decision){NOT_FINITE, 0, 0};
  if (seconds != 0 && seconds < SHORTEST_S) return (Decision){BAD_DURATION, seconds, SHORTEST_S};
  double most = fmax(seconds, dwell_s);
  if (most > LONGEST_S) return (Decision){BAD_DURATION, most, LONGEST_S};
  return dwell_s < 0 ? (Decision){BAD_DURATION, dwell_s, 0} : (Decision){ACCEPTED, 0, 0};
}

static Decision follow(const Byte *poses, int count, double seconds, double dwell_s, uint64_t id) { /* 6.7 to 6.10 */
  double pose[7], from[6], T[WAYPOINTS], to[WAYPOINTS][6];
  Decision d = {ACCEPTED, 0, 0};
  for (int k = 0; k < count && !d.reason; k++) d = is_pose(poses + 56 * k, k, count);
  if (!d.reason) d = times_fit(seconds, dwell_s);
  memcpy(from, at, sizeof at);
  memcpy(pose, poses, sizeof pose);
  double gap = sqrt((pose[0] - at[0]) * (pose[0] - at[0]) + (pose[1] - at[1]) * (pose[1] - at[1]) + (pose[2] - at[2]) * (pose[2] - at[2]));
  if (!d.reason && gap > FIRST_POSE_M) d = (Decision){TOO_FAR, gap, FIRST_POSE_M};
  for (int k = 0; k < count && !d.reason; k++) {
    memcpy(pose, poses + 56 * k, sizeof pose);
    d = place_fits(pose);
    axes_of(pose, to[k]);
  }
  for (int k = 0; k < count && !d.reason; k++) {
    d = timed(seconds, from, to[k], &T[k]);
    memcpy(from, to[k], sizeof from);
  }
  if (d.reason) return d;
  memcpy(path.to, to, sizeof to), memcpy(path.T, T, sizeof T);
  path.count = count, path.segment = 0, path.dwell_s = dwell_s;
  motion_id = id, arrived = motion_done = approaching = false;
  begin_segment();
  return d;
}

static void quintic(int k, double T, double t) { /* from place, speed and acceleration to rest */
  double h = path.to[path.segment][k] - path.from[k], v = path.v[k], a = path.a[k], u = t / T;
  if (t >= T) { at[k] = path.to[path.segment][k], speed[k] = acceleration[k] = 0; return; }
  double c3 = 10 * h - 6 * v * T - 1.5 * a * T * T, c4 = -15 * h + 8 * v * T + 1.5 * a * T * T;
  double c5 = 6 * h - 3 * v * T - 0.5 * a * T * T;
  at[k] = path.from[k] + v * t + a * t * t / 2 + u * u * u * (c3 + u * (c4 + u * c5));
  speed[k] = v + a * t + u * u * (3 * c3 + u * (4 * c4 + 5 * u * c5)) / T;
  acceleration[k] = a + u * (6 * c3 + u * (12 * c4 + 20 * u * c5)) / (T * T);
}

static void step_path(double dt) {
  path.t += dt;
  for (int k = 0; k < 6; k++) quintic(k, path.T[path.segment], path.t);
  if (path.t < path.T[path.segment] + (path.segment + 1 < path.count ? path.dwell_s : 0)) return;
  if (path.segment + 1 < path.count) path.segment++, begin_segment();
  else mode = STANDBY, arrived = true;
}

static double within(double x, double bound) { return fmax(-bound, fmin(bound, x)); }

static void step_stream(double dt, uint64_t now) { /* 12.7: place, speed and acceleration without a step */
  double ahead = stream.any && !approaching ? (double)(now - stream.at_ns) * 1e-9 : 0;
  bool there = true;
  for (int k = 0; k < 6; k++) {
    int turn = k >= 3;
    double gap = stream.to[k] + stream.twist[k] * ahead - at[k];
    double fastest = SPEED[turn] * AXIS, steepest = ACCELERATION[turn] * AXIS, braking = sqrt(steepest * fabs(gap)) * 0.7;
    double wanted = within(stream.twist[k] + within(within(5 * gap, braking), fastest), fastest);
    double a = within(10 * (wanted - speed[k]), steepest);
    acceleration[k] += within(a - acceleration[k], JERK[turn] * AXIS * dt);
    speed[k] += acceleration[k] * dt;
    at[k] += speed[k] * stream.pace * dt;
    there &= fabs(gap) < 5e-5 && fabs(speed[k]) < 5e-4;
  }
  if (!approaching || !there) return;
  memcpy(at, stream.to, sizeof at), memset(speed, 0, sizeof speed), memset(acceleration, 0, sizeof speed);
  mode = STANDBY, arrived = true;
}

static void latch(int what, int grave, int next) {
  if (!fault) fault = what; /* the first one (7.6) */
  if (grave > severity) severity = grave;
  mode = next;
  if (next == ERROR_RAMP) memcpy(ramp_from, speed, sizeof speed), ramp_s = 0;
}

static void watch_silence(double dt, uint64_t now) { /* 12.8 */
  double late = (double)(SILENCE_MS - 2 * CYCLE_MS - 2), quiet = (double)(now - stream.fresh_ns) / 1e6;
  if (!stream.any) { if (quiet > FIRST_REFERENCE_MS) latch(REFERENCE_STALE, SEVERITY_STOP, ERROR_HELD); return; }
  if (quiet > late) latch(REFERENCE_STALE, SEVERITY_STOP, ERROR_HELD);
  else if (quiet > late - STREAM_RAMP_MS) stream.pace = fmax(0, stream.pace - dt * 1e3 / STREAM_RAMP_MS);
  else stream.pace = fmin(1, stream.pace + dt * 1e3 / RECOVERY_MS);
}

static bool driven(void) { return mode >= STANDBY && mode <= ERROR_RAMP; }

static void step_arm(double dt, uint64_t now) {
  if (mode == STREAMING) watch_silence(dt, now);
  if (mode == MOVING && !approaching) step_path(dt);
  else if (mode == STREAMING || mode == MOVING) step_stream(dt, now);
  else if (mode == STOPPING || mode == DISABLING || mode == ERROR_RAMP) {
    ramp_s += dt;
    double share = fmax(0, 1 - ramp_s / RAMP_S);
    for (int k = 0; k < 6; k++) speed[k] = ramp_from[k] * share, at[k] += speed[k] * dt, acceleration[k] = 0;
    if (share == 0) mode = mode == STOPPING ? STANDBY : mode == DISABLING ? DISABLED : ERROR_HELD;
  }
  if (!driven()) memcpy(at, measured, sizeof at), memset(speed, 0, sizeof at), memset(acceleration, 0, sizeof at); /* 7.7 */
  else for (int k = 0; k < 6; k++) measured[k] += (at[k] - measured[k]) * dt / LAG_S;
}

static bool settled(void) {
  return mode == STANDBY && largest(at, measured, 0) < 2e-4 && largest(at, measured, 3) < 2e-4;
}

/* ---- one scan ---- */

static Decision enter(int column, Row row, uint64_t id) {
  int before = mode;
  if (row.reason) return (Decision){row.reason, 0, 0};
  if (column == EMERGENCY_STOP) { latch(FAULT_EMERGENCY, SEVERITY_EMERGENCY, EMERGENCY); return (Decision){0, 0, 0}; }
  if (column == RESET) fault = NO_FAULT, severity = 0;
  if (column == START_STREAM) {
    memset(&stream, 0, sizeof stream);
    stream.id = motion_id = id, stream.fresh_ns = scan_ns, stream.pace = 1, arrived = motion_done = approaching = false;
    memcpy(stream.to, at, sizeof at), streamed_waits = false;
  }
  if (column == END_STREAM) {
    for (int k = 0; k < 6; k++) /* rest where the reference was when it was accepted (12.10) */
      stream.to[k] += stream.any ? stream.twist[k] * (double)(stream.fresh_ns - stream.at_ns) * 1e-9 : 0, stream.twist[k] = 0;
    approaching = true, stream.pace = 1;
  }
  mode = row.next;
  if (mode != before && (mode == STOPPING || (mode == DISABLING && before != STOPPING)))
    memcpy(ramp_from, speed, sizeof speed), ramp_s = 0;
  return (Decision){ACCEPTED, 0, 0};
}

static Decision judge(const Request *r) { /* in the order of 6.10 */
  const Byte *p = r->payload;
  uint32_t code = r->kind == COMMAND ? GET(uint32_t, p, 8) : REFERENCE;
  uint32_t count = r->kind == REFERENCE_PATH ? GET(uint32_t, p, 8) : 1;
  Row row = TABLE[mode][code];
  if (code != REFERENCE) return enter((int)code, row, r->id);
  if (row.reason) return (Decision){row.reason, 0, 0};
  Decision d = r->kind == REFERENCE_POSE
                 ? follow(p + 8, 1, GET(double, p, 64), 0, r->id)
                 : follow(p + 16, (int)count, GET(double, p, 1360), GET(double, p, 1368), r->id);
  if (!d.reason) mode = row.next;
  return d;
}

static void judge_all(void) { /* stops first (6.12), nothing from before them after them (6.13), one reference (6.6) */
  int last_stop = -1;
  uint64_t newest_reference = 0;
  for (int k = 0; k < queued; k++) {
    if (is_stop(&queue[k])) last_stop = k;
    if (queue[k].kind != COMMAND && queue[k].id > newest_reference) newest_reference = queue[k].id;
  }
  for (int k = 0; k < queued; k++) {
    const Request *r = &queue[k];
    if (k < last_stop && !is_stop(r)) decide(r->id, overtaken(r->id, queue[last_stop].id));
    else if (r->kind != COMMAND && r->id < newest_reference) decide(r->id, overtaken(r->id, newest_reference));
    else decide(r->id, judge(r));
  }
  queued = 0;
}

static Decision streamed_fits(uint64_t now) { /* 12.4 */
  const Byte *p = streamed;
  double age_s = (double)(streamed_age_ns + (now - streamed_left_ns)) * 1e-9, pose[7], axes[6], fastest = 0;
  uint32_t number = GET(uint32_t, p, 8);
  if (!(open_session.capabilities & STREAMING_CAPABILITY)) return (Decision){NOT_NEGOTIATED, 0, 0};
  int reason = TABLE[mode][STREAMED].reason;
  uint64_t id = GET(uint64_t, p, 0);
  if (reason == NOT_STREAMING || (!reason && id != stream.id))
    return (Decision){NOT_STREAMING, (double)id, mode == STREAMING ? (double)stream.id : 0};
  if (reason) return (Decision){reason, 0, 0};
  if (stream.any && (int32_t)(number - stream.number) <= 0) return (Decision){OVERTAKEN, number, stream.number};
  if (age_s > GREATEST_AGE_S) return (Decision){STALE, age_s, GREATEST_AGE_S};
  Decision d = is_pose(p + 24, 0, 1);
  if (!d.reason && subnormal_or_not_finite(p + 80, 6)) return (Decision){NOT_FINITE, 0, 1};
  if (d.reason) return d;
  memcpy(pose, p + 24, sizeof pose);
  d = place_fits(pose);
  for (int k = 0; k < 6; k++) {
    double v = fabs(GET(double, p, 80 + 8 * k)), limit = TWIST * SPEED[k >= 3];
    if (v > limit && v / limit > fastest) fastest = v / limit, d = (Decision){TOO_FAST, v, limit};
  }
  if (fastest > 0) return d;
  axes_of(pose, axes);
  for (int turn = 0; turn < 2; turn++) {
    double gap[3] = {axes[3 * turn] - at[3 * turn], axes[3 * turn + 1] - at[3 * turn + 1], axes[3 * turn + 2] - at[3 * turn + 2]};
    double far = sqrt(gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]);
    if (far > FAR[turn]) return (Decision){TOO_FAR, far, FAR[turn]};
  }
  if (d.reason) return d; /* the workspace, last */
  memcpy(stream.to, axes, sizeof axes);
  for (int k = 0; k < 6; k++) stream.twist[k] = GET(double, p, 80 + 8 * k);
  stream.number = number, stream.any = true, stream.fresh_ns = streamed_left_ns;
  stream.at_ns = streamed_left_ns - streamed_age_ns;
  return d;
}

static void judge_streamed(uint64_t now) {
  if (!streamed_waits) return;
  streamed_waits = false;
  Decision d = streamed_fits(now);
  if (!d.reason || !open_session.number) return;
  Byte p[32];
  memcpy(p, streamed, 12);
  PUT(uint32_t, p, 12, (uint32_t)d.reason); PUT(double, p, 16, d.value); PUT(double, p, 24, d.limit);
  send_in(&open_session, STREAM_REFUSED, p);
}

static void watch_session(uint64_t now) { /* 5.4, 7.5 */
  if (open_session.number && now - open_session.heard_ns > LINK_TIMEOUT_MS * 1000000ull) end_session(LINK_TIMEOUT);
  if (!session_ended) return;
  session_ended = false;
  if (mode == STREAMING) stream.id = 0; /* it closes (12.2); silence stops the arm (12.8) */
  if (mode == STANDBY) mode = DISABLED;
  else if (mode == STOPPING) mode = DISABLING;
  else if (mode == MOVING) latch(REFERENCE_LINK_LOST, SEVERITY_STOP, ERROR_RAMP);
}

static void publish(uint64_t now) { /* 7.7 */
  Session *s = &open_session;
  if (!s->number || now - s->state_ns < s->period_ms * 1000000ull) return;
  s->state_ns = s->state_ns && now - s->state_ns < 2 * s->period_ms * 1000000ull ? s->state_ns + s->period_ms * 1000000ull : now;
  motion_done = motion_done || (arrived && (SECOND_THOUGHTS || settled())); /* not after a stop (7.8) */
  Byte p[336] = {0};
  double pose[7];
  PUT(uint64_t, p, 0, now); PUT(uint64_t, p, 8, FIRST_CYCLE + cycle);
  PUT(uint16_t, p, 16, (uint16_t)GROUP_STATE[mode]); PUT(uint16_t, p, 18, (uint16_t)fault); PUT(uint16_t, p, 20, (uint16_t)severity);
  PUT(uint16_t, p, 22, (uint16_t)(1 | (mode == EMERGENCY ? 2 : 0) | (settled() ? 4 : 0) | (mode == STREAMING ? 8 : 0)));
  PUT(uint64_t, p, 24, motion_id); PUT(uint32_t, p, 32, motion_id && motion_done); PUT(uint32_t, p, 36, (uint32_t)path.segment);
  memcpy(p + 40, measured, sizeof at), memcpy(p + 88, at, sizeof at);
  for (int k = 0; k < 6 && driven(); k++) PUT(double, p, 136 + 8 * k, within((at[k] - measured[k]) * 20, 1));
  pose_of(measured, pose), memcpy(p + 184, pose, sizeof pose);
  pose_of(at, pose);
  for (int k = 3; k < 7 && SECOND_THOUGHTS && cycle / 3 % 2; k++) pose[k] = -pose[k]; /* 1.5 */
  memcpy(p + 240, pose, sizeof pose);
  PUT(double, p, 296, 190.0); PUT(uint32_t, p, 304, overruns); PUT(uint32_t, p, 320, FIRST_COUNT + s->lost); PUT(uint32_t, p, 324, FIRST_COUNT + s->dropped);
  PUT(uint32_t, p, 332, mode == STREAMING ? stream.number : 0);
  send_in(s, STATE, p);
}

void controller_take(const Byte *d, size_t n, const struct sockaddr_in *from) { /* a datagram, as it comes */
  open_session.dropped += !receive(d, n, from, clock_ns());
}

void controller_scan(void) { /* every CYCLE_MS */
  uint64_t now = clock_ns();
  cycle++, scan_ns = now;
  watch_session(now);
  judge_all();
  judge_streamed(now);
  step_arm(CYCLE_MS * 1e-3, now);
  publish(now);
  answer_now();
}

int main(int count, char **arguments) {
  struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK),
                             .sin_port = htons(count > 1 ? (uint16_t)atoi(arguments[1]) : 47000)};
  socklen_t size = sizeof here;
  udp = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
  if (udp < 0 || bind(udp, (struct sockaddr *)&here, size) || getsockname(udp, (struct sockaddr *)&here, &size)) {
    perror("controller: no socket");
    return 1;
  }
  printf("{\"event\": \"ready\", \"port\": %d}\n", ntohs(here.sin_port));
  fflush(stdout);
  for (uint64_t next = now_ns();; next += CYCLE_MS * 1000000ull) {
    uint64_t now = now_ns();
    if (next < now) overruns += (uint32_t)((now - next) / (CYCLE_MS * 1000000ull)), next = now;
    do {
      struct pollfd waits = {udp, POLLIN, 0};
      now = now_ns();
      struct timespec left = {0, next > now ? (long)(next - now) : 0};
      if (ppoll(&waits, 1, &left, NULL) > 0) {
        Byte d[65536];
        struct sockaddr_in from;
        socklen_t length = sizeof from;
        for (ssize_t n; (n = recvfrom(udp, d, sizeof d, 0, (struct sockaddr *)&from, &length)) >= 0; length = sizeof from)
          controller_take(d, (size_t)n, &from); /* read empty before it is used (2.4) */
      }
    } while ((now = now_ns()) < next);
    controller_scan();
  }
}
