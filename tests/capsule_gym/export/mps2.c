/* The start of a Cortex-M4 in QEMU: stack, reset, and the floating-point unit, which is off after a
 * reset. */
extern void _start(void);
static void reset(void) {
  *(volatile unsigned*)0xE000ED88 |= 0xFu << 20;
  _start();
}
__attribute__((section(".vectors"), used)) static const void* vectors[] = {(void*)0x20400000,
                                                                           (void*)reset};
