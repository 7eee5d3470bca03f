/* Words that compilers spell differently. */
#ifndef UNDERTOW_PORTABLE
#define UNDERTOW_PORTABLE

#include <math.h>
#include <stdint.h>

/* What a library offers. */
#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

/* SEPARATE stands before a model: in its only caller it takes twice as long to compile and runs no faster. */
#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline, unused))
#define SEPARATE __attribute__((noinline, unused))
#define UNLIKELY(condition) __builtin_expect(condition, 0)
#else
#define INLINE static inline
#define SEPARATE
#define UNLIKELY(condition) (condition)
#endif

#endif
